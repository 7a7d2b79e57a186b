"""The compiled box-plus of poses. tests/vio/test_state.py holds the plain twin."""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import code_folder, compiled
from ovmot.kernels.rotations import multiply, orthonormalize, rotation_exp


def moved_poses(T: FloatArray, error: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) plus errors (K, 6): R exp(δθ), rounding taken out, and p + δp."""
    out, R, turn = np.zeros_like(T), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(T)):
        rotation_exp(error[k, :3], turn)
        multiply(T[k], turn, R)
        orthonormalize(R)
        for i in range(3):
            for j in range(3):
                out[k, i, j] = R[i, j]
            out[k, i, 3] = T[k, i, 3] + error[k, 3 + i]
        out[k, 3, 3] = 1.0
    return out


_FOLDER = code_folder(Path(__file__))
moved_poses_compiled = compiled(moved_poses, _FOLDER)
