"""Overlay of the segmentation: which points the ego motion explains, and which move."""

import numpy as np

from ovmot.geometry.arrays import BoolArray, Image
from ovmot.outputs import drawing, palette
from ovmot.types import PointLabel, ScenePoints, StereoFrame


def draw_dynamic(
    frame: StereoFrame, points: ScenePoints, seconds: float, scale: float = 1.0
) -> Image:
    """The left image with the segmentation's label of every point (BGR).

    Dynamic points, and static ones that the two-view test had rejected, show the previous
    observation white, the current one red and the prediction pink, joined by thin lines; their
    3-D distance (m) and reprojection error (px) are written in green for the dynamic ones and in
    red for the static ones, where there is room for them. Other points are small dots: static
    grey, unknown dark. `seconds` is the frame's time since the start. Pixels are enlarged by
    `scale`.
    """
    image = drawing.backdrop(frame.left, scale)
    now = points.pixels[:, :2]
    dynamic = points.label == PointLabel.DYNAMIC
    static = points.label == PointLabel.STATIC
    compared = np.all(np.isfinite(points.predicted), axis=1)
    rescued = static & ~points.two_view_inlier & compared
    unknown = ~dynamic & ~static
    drawing.dots(image, now[unknown], palette.DARK, scale, radius=1)
    drawing.dots(image, now[static & ~rescued], palette.GREY, scale, radius=1)
    for which in (rescued, dynamic):
        _draw_comparison(image, points, which, scale)
    written = rescued | dynamic
    colors = [palette.GREEN if moves else palette.RED for moves in dynamic[written]]
    unwritten = drawing.texts(image, now[written], _measures(points, written), colors, scale)
    drawing.caption(
        image,
        [
            (f"{seconds:.1f} s", palette.WHITE),
            (f"{np.count_nonzero(dynamic)} dynamic", palette.GREEN),
            (f"{np.count_nonzero(static)} static", palette.GREY),
            (f"{np.count_nonzero(rescued)} of them rejected by RANSAC", palette.RED),
            (f"{np.count_nonzero(unknown)} unknown", palette.GREY),
            ("previous", palette.WHITE), ("current", palette.RED), ("predicted", palette.PINK),
            (f"{unwritten} without room for numbers" if unwritten else "", palette.GREY),
        ],
    )  # fmt: skip
    return image


def _draw_comparison(image: Image, points: ScenePoints, which: BoolArray, scale: float) -> None:
    """Previous, current and predicted position of the chosen points, joined by thin lines."""
    now, previous, predicted = (
        points.pixels[which, :2], points.previous[which], points.predicted[which]
    )  # fmt: skip
    drawing.curves(image, np.stack([previous, now], axis=1), palette.WHITE, scale)
    drawing.curves(image, np.stack([now, predicted], axis=1), palette.PINK, scale)
    drawing.dots(image, previous, palette.WHITE, scale)
    drawing.dots(image, predicted, palette.PINK, scale)
    drawing.dots(image, now, palette.RED, scale)


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
