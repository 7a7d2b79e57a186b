"""Labels against an image of ids, and the stereo gate against an image of depth."""

import numpy as np
import pytest

from ovmot.datasets.truth import ObjectTruth
from ovmot.evaluation.labels import count_labels
from ovmot.evaluation.matching import ObjectCriteria
from ovmot.outputs.run_reader import LABELS, LabelledPoints

STAMP = 1_000
UNKNOWN, STATIC, DYNAMIC = range(3)


def points(rows: list[tuple[float, float, float, int]]) -> LabelledPoints:
    array = np.array(rows)
    return LabelledPoints(
        np.full(len(rows), STAMP), array[:, :2], array[:, 2], array[:, 3].astype(np.int64)
    )


def test_labels_are_counted_where_the_image_is_sure(truth: ObjectTruth) -> None:
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
    assert found.a_frame == 12.0


def test_no_points_no_rates(truth: ObjectTruth) -> None:
    found = count_labels(points([(120, 120, 60, DYNAMIC)]), truth, ObjectCriteria())
    assert (found.precision, found.recall, found.static_kept) == (None, None, None)
