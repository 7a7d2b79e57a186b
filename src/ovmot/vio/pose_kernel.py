"""The compiled box-plus of poses. tests/vio/test_state.py holds the plain twin."""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled, inlined_part
from ovmot.kernels.rotations import multiply, orthonormalize, rotation_exp


@inlined_part
def _move(
    R: FloatArray, p: FloatArray, error: FloatArray, turn: FloatArray,
    R_moved: FloatArray, p_moved: FloatArray,
) -> None:  # fmt: skip
    """R_moved (3, 3) = R exp(δθ), rounding taken out, and p_moved (3,) = p + δp; `error` (6,)."""
    rotation_exp(error[:3], turn)
    multiply(R, turn, R_moved)
    orthonormalize(R_moved)
    for i in range(3):
        p_moved[i] = p[i] + error[3 + i]


def moved_poses(
    T: FloatArray, R: FloatArray, p: FloatArray, error: FloatArray, first: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The clones' poses (K, 4, 4), and the rotation (3, 3) and position (3,) of the IMU, moved.

    By the error vector (N,): the IMU's errors are its first six, those of the clones, six each,
    begin at `first`.
    """
    out, turn = np.zeros_like(T), np.empty((3, 3))
    R_moved, p_moved = np.empty((3, 3)), np.empty(3)
    for k in range(len(T)):
        at = first + 6 * k
        _move(T[k], T[k, :3, 3], error[at : at + 6], turn, R_moved, p_moved)
        for i in range(3):
            for j in range(3):
                out[k, i, j] = R_moved[i, j]
            out[k, i, 3] = p_moved[i]
        out[k, 3, 3] = 1.0
    _move(R, p, error[:6], turn, R_moved, p_moved)
    return out, R_moved, p_moved


_FOLDER = code_folder(Path(__file__))
moved_poses_compiled = compiled(moved_poses, _FOLDER)
