"""The stereo gate against an image of depth."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import ObjectTruth
from ovmot.evaluation.stereo_gate import count_gate
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import GatedMatches

STAMP = 1_000


def match(u: float, v: float, du: float, dv: float = 0.0) -> list[float]:
    return [u, v, u - 10.0 + du, v + dv]  # a wall 6 m away: 200 px * 0.3 m / 6 m


def test_the_gate_is_held_against_the_depth(painted_rig: StereoRig, truth: ObjectTruth) -> None:
    rows = [
        (match(150, 100, 0), True), (match(160, 100, 2.5), True), (match(150, 90, 1), False),
        (match(170, 100, 20), True),  # slides along its line: no gate can see it
        (match(170, 120, 5, 8), False), (match(180, 120, 0, 4), False),
        (match(150, 10, 0), True),  # sky
        (match(150, 200, 0), True),  # a step of depth
    ]  # fmt: skip
    pixels: FloatArray = np.array([row for row, _ in rows])
    tested = GatedMatches(np.full(len(rows), STAMP), pixels, np.array([a for _, a in rows]))
    found = count_gate(tested, truth, painted_rig)
    assert (found.right_accepted, found.right_refused) == (2, 1)
    assert (found.wrong_accepted, found.wrong_refused) == (1, 2)
    assert found.precision == pytest.approx(2 / 3)
    assert found.recall == pytest.approx(2 / 3)
    assert found.wrong_refused_share == pytest.approx(2 / 3)
