"""The compiled search for a rigid motion equals its plain NumPy twin."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.rigid_kernel import (
    HEIGHT_SIGMAS,
    TRIPLES,
    Sample,
    best_row,
    ransac,
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


@pytest.mark.parametrize("twist", [TURN, np.array([0.0, 0.0, 0.0, 0.5, 0.1, 1.5])])
def test_the_search_equals_its_twin(rig: StereoRig, twist: FloatArray) -> None:
    """The same triples are drawn, and the best of all proposals is found."""
    rng = np.random.default_rng(4)
    p = rng.uniform([-2.0, -1.0, 12.0], [2.0, 1.0, 15.0], (20, 3))
    q = se3.apply(se3.exp(twist), p) + rng.normal(0.0, 0.01, p.shape)
    q[:4] += 1.0
    L = rng.normal(0.0, 200.0, (20, 4, 4))
    weight = L @ np.swapaxes(L, 1, 2) + 1e6 * np.eye(4)
    sigma, seen = rng.uniform(0.02, 0.2, 20), project_stereo(q, rig.T_cam1_cam0)[0]
    T10, least_cosine = np.ascontiguousarray(rig.T_cam1_cam0), float(np.cos(0.3))
    T, inlier, drawing = np.empty((4, 4)), np.empty(20, np.bool_), np.random.default_rng(7)
    sample = Sample(p, q, sigma, seen, weight)
    n = ransac(sample, T10, GATE, TURN_PENALTY, least_cosine, drawing, T, inlier)
    same = np.random.default_rng(7)
    triples = np.argsort(same.random((TRIPLES, 20)), axis=1)[:, :3].copy()
    expected = twin(triples, p, q, sigma, seen, weight, T10, least_cosine, GATE, TURN_PENALTY)
    np.testing.assert_allclose(T, expected[1], atol=1e-9)
    np.testing.assert_array_equal(inlier, expected[2])
    assert n == inlier.sum() and not inlier[:4].any() and n > 4
    assert drawing.random() == same.random()


def test_errors_are_traces_of_the_inverse() -> None:
    """The row of the least error; one that too few of the points saw does not count."""
    rng, index, span = np.random.default_rng(5), np.array([1, 4, 5]), np.array([0.8, 0.4, 0.2, 0.1])
    for accel in (0.0, 20.0):
        L = rng.normal(0.0, 3.0, (9, 4, 3, 3))
        information = L @ np.swapaxes(L, -1, -2)
        weight = np.tile(np.eye(4), (9, 4, 1, 1))
        weight[[1, 5], 0] = 0.0
        inverse = np.linalg.inv(information[index].sum(0) + 1e-6 * np.eye(3))
        error = np.trace(inverse, axis1=1, axis2=2) / span**2 + 0.5 * (accel * span) ** 2
        found = best_row(weight, information, index, span, accel)
        assert found == 1 + int(np.argmin(error[1:]))
