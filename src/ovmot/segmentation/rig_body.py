"""The rig's own body in its pictures: a bonnet, a dashboard, a propeller guard.

It stands still in the picture while the rig moves. To the segmentation it looks like a body that
drives with the rig. Cells of the pictures are counted: features that stood still although what is
at rest had to move there, and features that moved.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.physics import RIG_REACH_M
from ovmot.segmentation.rig_body_kernel import count_in_cells_compiled, find_standing_compiled
from ovmot.segmentation.segmentation import Segmentation
from ovmot.segmentation.static_comparison import ego_motion_since
from ovmot.types import PixelNoise, PointLabel, PoseWindow

_CELLS = 32
"""Columns of cells over a picture: those of `tracker.fine_columns`, one feature in each."""
_CERTAIN = 20
"""Times that a feature was seen to stand in a cell, until it counts as the rig's: two seconds at
10 Hz. One that slides over the street does not stand that long."""
_SHARE = 0.8
"""Of the features in such a cell, those that must stand: the others were there before the rig
moved, or seen through a pane."""


@dataclass(frozen=True, slots=True)
class RigBody:
    """How often features stood and moved in each cell (rows, columns) of the left and of the right
    picture."""

    stood: tuple[IntArray, IntArray]
    moved: tuple[IntArray, IntArray]

    def cells(self, side: int) -> BoolArray:
        """The cells (rows, columns) of a picture, 0 left, 1 right, that show the rig."""
        stood, moved = self.stood[side], self.moved[side]
        if stood.max(initial=0) < _CERTAIN:
            return np.zeros(stood.shape, dtype=np.bool_)
        mostly = stood >= _SHARE * (stood + moved)
        certain: BoolArray = (stood >= _CERTAIN) & mostly
        if not certain.any():
            return certain
        beside = (
            ndimage.binary_dilation(certain, np.ones((3, 3), dtype=np.bool_)) & (stood > 0) & mostly
        )
        rig: BoolArray = certain | beside
        return rig

    def shows(self, pixels: FloatArray, rig: StereoRig) -> BoolArray:
        """Which features (N,), by their pixels (N, 4), lie on the rig in either picture."""
        out = np.zeros(len(pixels), dtype=np.bool_)
        for side, camera in enumerate(rig.cameras):
            cells = self.cells(side)
            if cells.any():
                row, column, inside = _cell_of(pixels[:, 2 * side : 2 * side + 2], camera)
                out[inside] |= cells[row[inside], column[inside]]
        return out

    def mask(self, side: int, camera: Camera) -> Image | None:
        """The mask (height, width) of a picture, 255 on the rig; None where it is not seen."""
        cells = self.cells(side)
        if not cells.any():
            return None
        px = _cell_px(camera)
        whole = np.kron(cells, np.ones((px, px), dtype=np.uint8))
        return np.asarray(255 * whole[: camera.height, : camera.width], dtype=np.uint8)


def no_rig_body(rig: StereoRig) -> RigBody:
    """Nothing counted yet."""
    zeros = tuple(
        np.zeros((-(-c.height // _cell_px(c)), _CELLS), dtype=np.int64) for c in rig.cameras
    )
    left, right = zeros
    return RigBody((left, right), (left, right))


def counted(
    body: RigBody, stands: BoolArray, moves: BoolArray, pixels: FloatArray, rig: StereoRig
) -> RigBody:
    """The counts with those of a frame's features: which stand and which move (N,), by
    `standing_features`, and their pixels (N, 4)."""
    stood, moved, pixels = list(body.stood), list(body.moved), np.ascontiguousarray(pixels)
    for side, camera in enumerate(rig.cameras):
        stood[side], moved[side] = count_in_cells_compiled(
            pixels, side, stands, moves, _cell_px(camera), camera.width, camera.height,
            stood[side], moved[side],
        )  # fmt: skip
    return RigBody((stood[0], stood[1]), (moved[0], moved[1]))


def standing_features(
    history: StereoHistory, window: PoseWindow, rig: StereoRig
) -> tuple[BoolArray, BoolArray]:
    """Which features (N,) stand in the left picture although what is at rest moves, and which move.

    Each is compared with the oldest frame of the history that saw it. Where a point within the
    rig's reach would be, at rest, follows from its stereo pair; one of unknown depth is expected
    where the rotation alone leads it. A point farther away does not stand: another vehicle can keep
    its distance, and in a bend its bearing too. A feature stands that is within the noise of where
    it was, and off by ten times the noise from where it is expected.
    """
    T_now_then = ego_motion_since(history, window, rig).T_now_then
    sigma_px = _way_sigma_px(history.noise, history.n_frames)
    return find_standing_compiled(
        history.then, history.p_then, history.now, T_now_then, sigma_px, rig.cam0.fx, RIG_REACH_M
    )


def _way_sigma_px(noise: PixelNoise, n_frames: IntArray) -> FloatArray:
    """Standard deviation (L,) of a patch's way through the picture, where it has none, over numbers
    of frames (L,)."""
    return np.asarray(np.hypot(2.0**0.5 * noise.single_px, noise.drift_sigma_px(n_frames)))


def _cell_px(camera: Camera) -> int:
    return -(-camera.width // _CELLS)


def _cell_of(uv: FloatArray, camera: Camera) -> tuple[IntArray, IntArray, BoolArray]:
    """Row and column (N,) of the cells of pixels (N, 2), and which lie in the picture (N,)."""
    u, v = uv.T
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    px = _cell_px(camera)
    column = (np.where(inside, u, 0.0) // px).astype(np.int64)
    row = (np.where(inside, v, 0.0) // px).astype(np.int64)
    return row, column, inside


def without_rig_body(segmentation: Segmentation, on_rig: BoolArray) -> Segmentation:
    """The segmentation with what lies on the rig (N,) kept from the filter and from the objects."""
    if not on_rig.any():
        return segmentation
    points = segmentation.points
    label = np.where(on_rig, int(PointLabel.UNKNOWN), points.label)
    p_cam0 = np.where(on_rig[:, None], np.nan, points.p_cam0)
    return replace(
        segmentation,
        points=replace(points, label=label, p_cam0=p_cam0),
        outlier=segmentation.outlier | on_rig,
    )
