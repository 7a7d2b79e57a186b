"""The robust test between two consecutive left images."""

import cv2
import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray

_MIN_POINTS = 12
_CONFIDENCE = 0.999
_MAX_ITERATIONS = 500


def two_view_inliers(before: FloatArray, now: FloatArray, threshold: float) -> BoolArray:
    """Which of N tracks agree with one rigid motion of the camera.

    `before`, `now` (N, 2): undistorted plane coordinates; `threshold` in plane units. Fundamental
    matrix by MAGSAC++ (D. Barath et al., CVPR 2020): in the undistorted plane it is the essential
    matrix, and found in half the time. With fewer than 12 tracks, or when no motion is found, all
    pass: the test then knows nothing.
    """
    ok = np.asarray(np.isfinite(before).all(1) & np.isfinite(now).all(1))
    if ok.sum() < _MIN_POINTS:
        return ok
    # The solver's own tolerances are made for pixels: give it coordinates of that size.
    scale = 1.0 / threshold
    try:
        _, mask = cv2.findFundamentalMat(
            before[ok] * scale, now[ok] * scale, cv2.USAC_MAGSAC, 1.0, _CONFIDENCE, _MAX_ITERATIONS
        )
    except cv2.error:  # raised, by some noisy inputs, where the last refinement finds no model
        return ok
    if mask is None or mask.sum() < _MIN_POINTS:
        return ok
    inliers = np.zeros(len(before), dtype=np.bool_)
    inliers[ok] = mask.ravel() > 0
    return inliers
