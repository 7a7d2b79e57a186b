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
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray
from ovmot.physics import RIG_REACH_M
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
        mostly = stood >= _SHARE * (stood + moved)
        certain = (stood >= _CERTAIN) & mostly
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
    stood, moved = list(body.stood), list(body.moved)
    for side, camera in enumerate(rig.cameras):
        row, column, inside = _cell_of(pixels[:, 2 * side : 2 * side + 2], camera)
        for which, counts in ((stands, stood), (moves, moved)):
            at = which & inside
            counts[side] = counts[side].copy()
            np.add.at(counts[side], (row[at], column[at]), 1)
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
    stands, moves, open_ = (np.zeros(len(history.now), dtype=np.bool_) for _ in range(3))
    open_[:] = True
    T_now_then = ego_motion_since(history, window, rig).T_now_then
    for k in range(len(history)):
        seen = open_ & np.isfinite(history.then[k, :, 0])
        sigma_px = _way_sigma_px(history.noise, int(history.n_frames[k]))
        way_px = rig.cam0.fx * np.linalg.norm(history.now[:, :2] - history.then[k, :, :2], axis=1)
        off_px = _expected_way_px(history.then[k, :, :2], history.p_then[k], T_now_then[k], rig)
        with np.errstate(invalid="ignore"):
            stands |= seen & (off_px > 10.0 * sigma_px) & (way_px < 3.0 * sigma_px)
            moves |= seen & (way_px > 6.0 * sigma_px)
        open_ &= ~seen
    return stands, moves


def _expected_way_px(
    then: FloatArray, p_then: FloatArray, T_now_then: FloatArray, rig: StereoRig
) -> FloatArray:
    """How far (N,) points at rest move in the left picture, pixels: infinite for those that the rig
    has passed by, NaN beyond its reach.

    `then` (N, 2): normalized coordinates; `p_then` (N, 3): positions, metres, NaN where unknown.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        unknown, far = np.isnan(p_then[:, 2]), p_then[:, 2] >= RIG_REACH_M
        ray = np.concatenate([then, np.ones((len(then), 1))], axis=1)
        turned, moved = ray @ T_now_then[:3, :3].T, se3.apply(T_now_then, p_then)
        now = np.where(unknown[:, None], turned, moved)
        way = rig.cam0.fx * np.linalg.norm(now[:, :2] / now[:, 2:] - then, axis=1)
        return np.where(far, np.nan, np.where(now[:, 2] > 0.0, way, np.inf))


def _way_sigma_px(noise: PixelNoise, n_frames: int) -> float:
    """Standard deviation of a patch's way through the picture, where it has none, over frames."""
    drift = float(noise.drift_sigma_px(np.array([n_frames]))[0])
    return float(np.hypot(2.0**0.5 * noise.single_px, drift))


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
