"""A written VIODE folder: its instance images become masks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from written_formats import (
    SEED,
    of_form,
    rendered,
)

from ovmot.datasets.instance_masks import InstanceMasks
from ovmot.datasets.registry import WRITERS, open_sequence
from ovmot.errors import InputError
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


def test_segmentation_of_viode_becomes_masks(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = of_form("viode", small_simulation)
    list(WRITERS["viode"](tmp_path, record(simulation, SEED)))
    sequence = open_sequence(tmp_path)
    assert sequence.instances is not None
    frame = rendered("viode", simulation)[1]
    seen = np.unique(frame.left.object_id)
    ids = tuple(int(i) for i in seen[seen > 0][:2])
    assert len(ids) == 2
    masks = InstanceMasks.make(sequence.instances, ids, sequence.rig)
    left, right = masks.of(frame.frame.timestamp_ns)
    assert left is not None and right is not None
    np.testing.assert_array_equal(left > 0, np.isin(frame.left.object_id, ids))
    np.testing.assert_array_equal(right > 0, np.isin(frame.right.object_id, ids))
    assert masks.of(1) == (None, None)
    (tmp_path / "segmentation/rgb_ids.txt").unlink()
    bare = open_sequence(tmp_path)
    assert bare.counts["no_segmentation_colours"] == 1
    assert bare.instances is not None
    with pytest.raises(InputError, match=r"segmentation/\d+\.png: no colour is known for id"):
        replace(masks, instances=bare.instances).of(frame.frame.timestamp_ns)
