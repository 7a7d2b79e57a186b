"""The right image along epipolar curves: where features are whose depth is not known."""

import numpy as np

from ovmot.cameras.lens_kernel import packed_camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.epipolar_scan_kernel import ScanRules, scan_curves_compiled
from ovmot.frontend.klt_kernel import margin_of
from ovmot.frontend.klt_tracker import TrackedPoints
from ovmot.frontend.preprocessing import View
from ovmot.geometry.arrays import BoolArray, FloatArray

_MOST_DISPARITY = 1.0 / 8.0
"""Of the image's width: 2.6 m of KITTI's rig, 0.6 m of EuRoC's."""
_LEAST_CORRELATION = np.sqrt(0.5)  # half of the variance is explained
_RATIO = 0.8
"""Of the distances of the best match and of the next: D. Lowe, IJCV 2004, fig. 11."""
_NOISE = 2.0  # grey levels, of a camera's picture with its contrast corrected


def scan_epipolar(
    left: View, right: View, points: TrackedPoints, wanted: BoolArray, rig: StereoRig
) -> tuple[FloatArray, BoolArray]:
    """Right pixels (N, 2) where the `wanted` features (N,) of the left view fit best, to within a
    pixel or two, NaN where nowhere; and which of them fit as well elsewhere (N,).

    A row of windows that is matched to its neighbours is at a wrong depth, and seems to move.
    """
    if min(len(left.pyramid.levels), len(right.pyramid.levels)) < 2:
        return np.full((len(points), 2), np.nan), np.zeros(len(points), np.bool_)
    least_depth = rig.baseline * left.camera.fx / (_MOST_DISPARITY * left.camera.width)
    return scan_curves_compiled(
        left.pyramid.levels[1], right.pyramid.levels[1], margin_of(left.pyramid.window),
        points.uv, points.xy, wanted, rig.T_cam1_cam0, *packed_camera(right.camera),
        ScanRules(least_depth, float(_LEAST_CORRELATION), _RATIO, _NOISE),
    )  # fmt: skip
