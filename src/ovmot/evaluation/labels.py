"""Labels of points against the image of object ids: precision and recall of `dynamic`."""

from dataclasses import dataclass

import cv2
import numpy as np

from ovmot.datasets.truth import ObjectTruth
from ovmot.evaluation.matching import ObjectCriteria
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.outputs.run_reader import LABELS, LabelledPoints

_EDGE = np.ones((7, 7), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class LabelCounts:
    """Points labelled dynamic that move (`hits`) or rest (`false`), and points labelled static that
    move (`missed`) or rest (`kept`); and the number of all points in a frame, mean."""

    hits: int
    false: int
    missed: int
    kept: int
    a_frame: float

    @property
    def precision(self) -> float | None:
        return self.hits / (self.hits + self.false) if self.hits + self.false else None

    @property
    def recall(self) -> float | None:
        return self.hits / (self.hits + self.missed) if self.hits + self.missed else None

    @property
    def static_kept(self) -> float | None:
        """Share of the resting points that are called static."""
        return self.kept / (self.kept + self.false) if self.kept + self.false else None


def count_labels(
    points: LabelledPoints, truth: ObjectTruth, criteria: ObjectCriteria
) -> LabelCounts:
    """Compare all labels `static` and `dynamic` with what moves at the point's pixel.

    Left out are points beyond the range or without depth, and those within 3 pixels of an
    object's outline, where the image does not say whose they are.
    """
    counts = np.zeros((2, 2), dtype=np.int64)
    dynamic = LABELS.index("dynamic")
    near = points.depth < criteria.max_range_m
    judged = near & (points.label != LABELS.index("unknown"))
    for stamp in np.unique(points.timestamp_ns[judged]).tolist():
        objects = truth.frames.get(stamp)
        if objects is None:
            continue
        moving = objects.object_id[
            np.linalg.norm(objects.velocity, axis=1) > criteria.min_speed_mps
        ]
        rows = np.flatnonzero(judged & (points.timestamp_ns == stamp))
        ids = inner_ids(truth.read_ids(stamp))
        at, inside = pixel_index(points.pixel[rows], ids)
        known = inside & (ids[at] >= 0)
        moves = np.isin(ids[at], moving)[known]
        called = (points.label[rows] == dynamic)[known]
        np.add.at(counts, (moves.astype(np.int64), called.astype(np.int64)), 1)
    return LabelCounts(
        hits=int(counts[1, 1]), false=int(counts[0, 1]),
        missed=int(counts[1, 0]), kept=int(counts[0, 0]),
        a_frame=len(points.label) / max(len(np.unique(points.timestamp_ns)), 1),
    )  # fmt: skip


def inner_ids(id_image: Image) -> IntArray:
    """The image of ids (H, W), -1 near outlines."""
    widest, narrowest = cv2.dilate(id_image, _EDGE), cv2.erode(id_image, _EDGE)
    edge = np.asarray(widest) != np.asarray(narrowest)
    return np.where(edge, -1, id_image.astype(np.int64))


def pixel_index(
    pixel: FloatArray, image: IntArray | FloatArray
) -> tuple[tuple[IntArray, IntArray], BoolArray]:
    """Row and column (M,) of the nearest pixels, and which (M,) lie in the image.

    Those outside point to the nearest pixel inside.
    """
    height, width = image.shape[:2]
    finite = np.asarray(np.isfinite(pixel).all(axis=1))
    nearest = np.round(np.where(finite[:, None], pixel, -1.0)).astype(np.int64)
    u, v = nearest[:, 0], nearest[:, 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return (np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)), inside
