"""The compiled measurements equal their plain NumPy twin."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.measurement_kernel import (
    BodyPoints,
    BodyTwists,
    MeasuredBodies,
    measure_bodies,
    measure_bodies_compiled,
)

N_BODIES, N_POINTS, N_POSES, ACCEL = 3, 30, 5, 1.0
Case = tuple[BodyPoints, BodyTwists, FloatArray, FloatArray]


@pytest.fixture
def case() -> Case:
    """Three bodies, the last with two inliers only, and five poses."""
    rng = np.random.default_rng(5)

    def covariances(*shape: int) -> FloatArray:
        A = rng.normal(0.0, 0.1, shape)
        return np.asarray(A @ np.swapaxes(A, -1, -2))

    body = np.sort(rng.integers(0, N_BODIES, N_POINTS))
    inlier = rng.random(N_POINTS) < 0.8
    inlier[np.flatnonzero(body == 2)[2:]] = False
    origin = rng.uniform(-20.0, 20.0, (N_BODIES, 3))
    p = origin[body] + rng.uniform(-2.0, 2.0, (N_POINTS, 3))
    points = BodyPoints(
        p, rng.normal(size=(N_POINTS, 3, 6)), covariances(N_POINTS, 3, 3), body, inlier
    )
    bodies = BodyTwists(
        rng.normal(0.0, 0.5, (N_BODIES, 6)), covariances(N_BODIES, 6, 6),
        origin, np.array([0.5, 0.9, 0.3]), np.array([1, 0, 4]),
    )  # fmt: skip
    T = se3.exp(rng.normal(0.0, 0.5, (N_POSES, 6)))
    return points, bodies, T, covariances(6 * N_POSES, 6 * N_POSES)


def ego_part(
    position: FloatArray, T_now_before: FloatArray, span_s: float, T: FloatArray, P: FloatArray,
    clone: int,
) -> FloatArray:  # fmt: skip
    """Covariance (6, 6) by the derivatives of position and velocity by the poses."""
    before = se3.apply(se3.inverse(T_now_before), position)
    J = np.zeros((6, 12))
    for k, (pose, p) in enumerate([(T[-1], position), (T[clone], before)]):
        R, sign = pose[:3, :3], 1.0 - 2.0 * k
        by_pose = np.hstack([-R @ so3.hat(R.T @ (p - pose[:3, 3])), np.eye(3)])
        if k == 0:
            J[:3, :6] = by_pose
        J[3:6, 6 * k : 6 * k + 6] = sign * by_pose / span_s
    last = 6 * (len(T) - 1)
    index = np.r_[last : last + 6, 6 * clone : 6 * clone + 6]
    return np.asarray(J @ P[np.ix_(index, index)] @ J.T)


@pytest.mark.parametrize("measure", [measure_bodies, measure_bodies_compiled])
def test_bodies_are_measured_as_by_the_twin(
    case: Case, measure: Callable[..., MeasuredBodies]
) -> None:
    points, bodies, T, P = case
    found = measure(points, bodies, T, P, ACCEL, 3)
    members = [found.members[found.first[b] :][: found.n_members[b]] for b in range(N_BODIES)]
    assert found.n_members[2] == 2 and not found.covariance[2].any()
    for b in range(2):
        own, xi = np.flatnonzero((points.body == b) & points.inlier), bodies.twist[b]
        assert members[b].tolist() == own.tolist()
        p, yaw = points.p_world[own], np.arctan2(xi[4], xi[3])
        R = so3.exp(np.array([0.0, 0.0, yaw]))
        low, high = (p @ R).min(0), (p @ R).max(0)
        np.testing.assert_allclose(found.size[b], high - low, rtol=1e-9)
        np.testing.assert_allclose(found.position[b], R @ (0.5 * (low + high)), rtol=1e-9)
        np.testing.assert_allclose(found.middle[b], np.median(p, axis=0), rtol=1e-9)
        shift = se3.make(np.eye(3), bodies.origin[b])
        motion = shift @ se3.exp(bodies.span_s[b] * xi) @ se3.inverse(shift)
        np.testing.assert_allclose(found.T_now_before[b], motion, atol=1e-9)
        arm = found.position[b] - bodies.origin[b]
        np.testing.assert_allclose(found.velocity[b], xi[3:] + np.cross(xi[:3], arm), rtol=1e-9)
        J = np.zeros((6, 6))
        J[:3], J[3:, :3] = points.by_twist[own].mean(0), -so3.hat(arm)
        J[3:, 3:] = np.eye(3)
        of_points = J @ bodies.cov[b] @ J.T
        of_points[:3, :3] += points.cov[own].sum(0) / len(own) ** 2
        slack = np.zeros((6, 6))
        slack[3:, 3:] = (0.5 * ACCEL * bodies.span_s[b]) ** 2 * np.eye(3)
        clone = int(bodies.clone[b])
        ego = ego_part(found.position[b], motion, float(bodies.span_s[b]), T, P, clone)
        expected = of_points + slack + ego
        np.testing.assert_allclose(found.covariance[b], expected, rtol=1e-8, atol=1e-9)
