"""Overlay of the segmentation: which points the ego motion explains, and which move."""

import numpy as np

from ovmot.geometry.arrays import BoolArray, Image
from ovmot.outputs import drawing
from ovmot.types import PointLabel, ScenePoints, StereoFrame


def draw_dynamic(frame: StereoFrame, points: ScenePoints, scale: float = 1.0) -> Image:
    """The left image with the segmentation's label of every point (BGR).

    Dynamic points, and static ones that the two-view test had rejected, show the previous
    observation white, the current one red and the prediction pink, joined by thin lines; their
    3-D distance (m) and reprojection error (px) are written in green for the dynamic ones and in
    red for the static ones. Other points are small dots: static grey, unknown dark. Pixels are
    enlarged by `scale`.
    """
    image = drawing.backdrop(frame.left, scale)
    now = points.pixels[:, :2]
    dynamic = points.label == PointLabel.DYNAMIC
    static = points.label == PointLabel.STATIC
    compared = np.all(np.isfinite(points.predicted), axis=1)
    rescued = static & ~points.two_view_inlier & compared
    unknown = ~dynamic & ~static
    drawing.dots(image, now[unknown], drawing.DARK, scale, radius=1)
    drawing.dots(image, now[static & ~rescued], drawing.GREY, scale, radius=1)
    for which, color in ((rescued, drawing.RED), (dynamic, drawing.GREEN)):
        drawing.texts(image, now[which], _measures(points, which), color, scale)
    for which in (rescued, dynamic):
        _draw_comparison(image, points, which, scale)
    drawing.caption(
        image,
        [
            (f"t {1e-9 * frame.timestamp_ns:.3f} s", drawing.WHITE),
            (f"{np.count_nonzero(dynamic)} dynamic", drawing.GREEN),
            (f"{np.count_nonzero(static)} static", drawing.GREY),
            (f"{np.count_nonzero(rescued)} of them rejected by RANSAC", drawing.RED),
            (f"{np.count_nonzero(unknown)} unknown", drawing.GREY),
            ("previous", drawing.WHITE), ("current", drawing.RED), ("predicted", drawing.PINK),
        ],
    )  # fmt: skip
    return image


def _draw_comparison(image: Image, points: ScenePoints, which: BoolArray, scale: float) -> None:
    """Previous, current and predicted position of the chosen points, joined by thin lines."""
    now, previous, predicted = (
        points.pixels[which, :2], points.previous[which], points.predicted[which]
    )  # fmt: skip
    drawing.curves(image, np.stack([previous, now], axis=1), drawing.WHITE, scale)
    drawing.curves(image, np.stack([now, predicted], axis=1), drawing.PINK, scale)
    drawing.dots(image, previous, drawing.WHITE, scale)
    drawing.dots(image, predicted, drawing.PINK, scale)
    drawing.dots(image, now, drawing.RED, scale)


def _measures(points: ScenePoints, which: BoolArray) -> list[str]:
    """The two distances of the comparison in words; a missing one is left out."""
    return [
        " ".join(
            word for value, word in ((d, f"{d:.2f}m"), (r, f"{r:.1f}px")) if not np.isnan(value)
        )
        for d, r in zip(
            points.distance_m[which].tolist(), points.reprojection_px[which].tolist(), strict=True
        )
    ]
