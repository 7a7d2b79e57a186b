"""Labels against a picture of ids, and the stereo gate against a picture of depth."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import ObjectTruth, read_object_truth
from ovmot.evaluation.labels import count_labels
from ovmot.evaluation.matching import ObjectCriteria
from ovmot.evaluation.stereo_gate import count_gate
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import LABELS, GatedMatches, LabelledPoints

STAMP = 1_000
UNKNOWN, STATIC, DYNAMIC = range(3)


@pytest.fixture
def truth(tmp_path: Path) -> ObjectTruth:
    """One frame of 320x240: a moving car (id 1) and a parked one (id 2); a wall 6 m away."""
    folder = tmp_path / "data" / "truth"
    (folder / "depth").mkdir(parents=True)
    car = dict.fromkeys(("x", "y", "z", "yaw", "l", "w", "h", "vx", "vy", "yaw_rate"), 0.0)
    listed = [{"t_ns": STAMP, "objects": [
        {**car, "id": 1, "vx": 4.0, "visible_px": 900}, {**car, "id": 2, "visible_px": 900},
    ]}]  # fmt: skip
    (folder / "objects.json").write_text(json.dumps(listed))
    ids = np.zeros((240, 320), dtype=np.uint8)
    ids[100:140, 100:140], ids[100:140, 200:240] = 1, 2
    cv2.imwrite(str(folder / f"{STAMP}.png"), ids)
    depth = np.full((240, 320), 6 * 256, dtype=np.uint16)
    depth[:20] = 0
    depth[200:] = 3 * 256
    cv2.imwrite(str(folder / "depth" / f"{STAMP}.png"), depth)
    found = read_object_truth(tmp_path / "data")
    assert found is not None
    return found


def points(rows: list[tuple[float, float, float, int]]) -> LabelledPoints:
    array = np.array(rows)
    return LabelledPoints(
        np.full(len(rows), STAMP), array[:, :2], array[:, 2], array[:, 3].astype(np.int64)
    )


def test_labels_are_counted_where_the_picture_is_sure(truth: ObjectTruth) -> None:
    assert LABELS == ("unknown", "static", "dynamic")
    found = count_labels(
        points([
            (120, 120, 8, DYNAMIC), (121, 121, 8, DYNAMIC), (119, 118, 8, STATIC),  # the car
            (220, 120, 8, DYNAMIC), (221, 121, 8, STATIC), (20, 20, 8, STATIC),  # at rest
            (120, 120, 8, UNKNOWN), (120, 120, 60, DYNAMIC), (120, 120, np.nan, DYNAMIC),
            (101, 120, 8, DYNAMIC), (98, 120, 8, DYNAMIC), (-3, 20, 8, DYNAMIC),
        ]),
        truth, ObjectCriteria(),
    )  # fmt: skip
    assert (found.hits, found.missed, found.false, found.kept) == (2, 1, 1, 2)
    assert found.precision == pytest.approx(2 / 3)
    assert found.recall == pytest.approx(2 / 3)
    assert found.static_kept == pytest.approx(2 / 3)


def test_no_points_no_rates(truth: ObjectTruth) -> None:
    found = count_labels(points([(120, 120, 60, DYNAMIC)]), truth, ObjectCriteria())
    assert (found.precision, found.recall, found.static_kept) == (None, None, None)


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
