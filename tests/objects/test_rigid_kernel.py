"""The compiled search for a rigid motion equals its plain NumPy twin."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.rigid_kernel import (
    HEIGHT_SIGMAS,
    best_motion,
    best_motion_compiled,
)

GATE, TURN_PENALTY = 18.5, 11.3
TURN = np.array([0.02, -0.01, 0.1, 0.5, -0.2, 1.5])


def register(p: FloatArray, q: FloatArray) -> FloatArray:
    """Motions (B, 4, 4) of triangles (B, 3, 3) (W. Kabsch 1976)."""
    a, b = p - p.mean(1, keepdims=True), q - q.mean(1, keepdims=True)
    R = so3.project_to_rotation(np.swapaxes(b, -1, -2) @ a)
    return se3.make(R, q.mean(1) - (R @ p.mean(1)[..., None])[..., 0])


def height(q: FloatArray) -> FloatArray:
    """Smallest heights (B,) of triangles (B, 3, 3)."""
    sides = np.roll(q, -1, axis=1) - q
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(area / np.linalg.norm(sides, axis=2).max(1))


def twin(
    triples: IntArray, p: FloatArray, q: FloatArray, sigma: FloatArray, seen: FloatArray,
    weight: FloatArray, T_cam1_cam0: FloatArray, least_cosine: float, gate: float,
    turn_penalty: float,
) -> tuple[float, FloatArray, BoolArray]:  # fmt: skip
    """All proposals at once."""
    w = (sigma[triples] ** -2.0)[..., None]
    shift = (w * (q - p)[triples]).sum(1) / w.sum(1)
    wide = height(q[triples]) > HEIGHT_SIGMAS * sigma[triples].max(1)
    rigid = register(p[triples[wide]], q[triples[wide]])
    slow = 0.5 * (np.trace(rigid[:, :3, :3], axis1=1, axis2=2) - 1.0) > least_cosine
    T = np.concatenate([se3.make(np.eye(3), shift), rigid[slow]])
    r = seen - project_stereo(se3.apply(T[:, None], p), T_cam1_cam0)[0]
    distance = np.einsum("hni,nij,hnj->hn", r, weight, r)
    penalty = np.repeat([0.0, turn_penalty], [len(shift), int(slow.sum())])
    cost = np.minimum(distance, gate).sum(1) + penalty
    k = int(np.argmin(cost))
    return float(cost[k]), T[k], distance[k] < gate


@pytest.mark.parametrize("search", [best_motion, best_motion_compiled])
@pytest.mark.parametrize("twist", [TURN, np.array([0.0, 0.0, 0.0, 0.5, 0.1, 1.5])])
def test_the_search_equals_its_twin(
    rig: StereoRig, twist: FloatArray, search: Callable[..., tuple[float, FloatArray, BoolArray]]
) -> None:
    rng = np.random.default_rng(4)
    p = rng.uniform([-2.0, -1.0, 12.0], [2.0, 1.0, 15.0], (20, 3))
    q = se3.apply(se3.exp(twist), p) + rng.normal(0.0, 0.01, p.shape)
    q[:4] += 1.0
    L = rng.normal(0.0, 200.0, (20, 4, 4))
    weight = L @ np.swapaxes(L, 1, 2) + 1e6 * np.eye(4)
    seen = project_stereo(q, rig.T_cam1_cam0)[0]
    triples = np.argsort(rng.random((24, 20)), axis=1)[:, :3].copy()
    given = (
        triples,
        p,
        q,
        rng.uniform(0.02, 0.2, 20),
        seen,
        weight,
        rig.T_cam1_cam0,
        np.cos(0.3),
        GATE,
        TURN_PENALTY,
    )
    expected = twin(*given)
    cost, T, inlier = search(*given)
    np.testing.assert_allclose(cost, expected[0], rtol=1e-9)
    np.testing.assert_allclose(T, expected[1], atol=1e-9)
    np.testing.assert_array_equal(inlier, expected[2])
    assert not inlier[:4].any() and inlier[4:].any()
