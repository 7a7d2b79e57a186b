"""The compiled filter of a body equals its plain NumPy twin; its Jacobians are the differences."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.so3 import rotation_z
from ovmot.geometry.triangulation import project_stereo
from ovmot.objects.body import GATES
from ovmot.objects.body_kernel import (
    LEFT,
    N_BODY,
    REFUSED,
    STEREO,
    UNSEEN,
    BodyState,
    EgoStep,
    Gates,
    Manoeuvres,
    StereoView,
    predict_body,
    update_body,
)

ROAD = Manoeuvres(accel=1.5, yaw_rate=0.25, time_s=2.0, lift=0.2, match=2e-4)
T_CAM1_CAM0 = se3.inverse(se3.exp(np.array([0.47, 0.01, -0.01, 0.01, -0.02, 0.005])))
N = 6


def covariance(rng: np.random.Generator, n: int, scale: float) -> FloatArray:
    A = rng.normal(0.0, scale, (n, n))
    return A @ A.T / n + 1e-6 * np.eye(n)


def ahead(rng: np.random.Generator, speed: float = 6.0) -> BodyState:
    """A body some 12 m ahead of a camera that looks along the world's z."""
    x = np.concatenate([[0.5, -0.3, 12.0, 0.4, speed, 2.0, 0.3, 0.2, -0.8, 0.5, 1e-4]])
    f = rng.uniform(-1.5, 1.5, (N, 3))
    return BodyState(x, f, covariance(rng, N_BODY + 3 * N, 0.03))


def step_of(rng: np.random.Generator) -> EgoStep:
    T = np.stack([se3.exp(rng.normal(0.0, 0.3, 6)) for _ in range(2)])
    return EgoStep(T, covariance(rng, 12, 0.01), rng.normal(0.0, 0.5, 3))


def moved(x: FloatArray, dt: float) -> FloatArray:
    """The state after dt seconds."""
    decay = np.exp(-dt / ROAD.time_s)
    to_v = ROAD.time_s * (1.0 - decay)
    to_p = ROAD.time_s * (dt - to_v)
    half, whole = (rotation_z(share * x[7] * to_v)[:2, :2] for share in (0.5, 1.0))
    out = x.copy()
    out[:2] = x[:2] + dt * half @ x[4:6] + to_p * x[8:10]
    out[2] += dt * x[6]
    out[3] += to_v * x[7]
    out[4:6] = whole @ x[4:6] + to_v * x[8:10]
    out[7:] = decay * x[7:]
    return out


def differences(function: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """The derivative of a function by its argument, by central differences."""
    steps = 1e-6 * np.eye(len(x))
    return np.stack([(function(x + d) - function(x - d)) / 2e-6 for d in steps], axis=1)


def process_noise(dt: float, speed: float) -> FloatArray:
    Q = np.zeros((N_BODY, N_BODY))
    q = 2.0 * ROAD.accel**2 / ROAD.time_s
    jerk = np.array([dt**2 / 2.0, dt, 1.0])
    three = q * np.array([
        [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
        [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
        [dt**3 / 6.0, dt**2 / 2.0, dt],
    ])  # fmt: skip
    assert jerk[2] == 1.0
    for k in range(2):
        Q[np.ix_([k, 4 + k, 8 + k], [k, 4 + k, 8 + k])] = three
    two = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    Q[np.ix_([2, 6], [2, 6])] = ROAD.lift**2 * two
    rate = min(ROAD.yaw_rate, ROAD.accel / speed)
    Q[np.ix_([3, 7], [3, 7])] = 2.0 * rate**2 / ROAD.time_s * two
    Q[10, 10] = ROAD.match**2 * (1.0 - np.exp(-2.0 * dt / ROAD.time_s))
    return Q


def seen_offset(x: FloatArray, ego: EgoStep, error: FloatArray) -> FloatArray:
    """By how much place and yaw (4,) are off, if the rig's poses have an error (12,)."""
    out = np.zeros(4)
    for k, sign in ((0, -1.0), (1, 1.0)):
        T = ego.T_world_imu[k]
        turn, shift = error[6 * k : 6 * k + 3], error[6 * k + 3 : 6 * k + 6]
        T_true = se3.make(T[:3, :3] @ so3.exp(turn), T[:3, 3] + shift)
        out[:3] += sign * (se3.apply(T_true @ se3.inverse(T), x[None, :3])[0] - x[:3])
        out[3] += sign * (T[:3, :3] @ turn)[2]
    return out


def predicted(s: BodyState, dt: float, ego: EgoStep, drift: FloatArray) -> BodyState:
    """The plain twin of `predict_body`."""
    n = len(s.P)
    F = np.eye(n)
    F[:N_BODY, :N_BODY] = differences(lambda x: moved(x, dt), s.x)
    P = F @ s.P @ F.T
    P[:N_BODY, :N_BODY] += process_noise(dt, float(np.hypot(*s.x[4:6])))
    G = differences(lambda e: seen_offset(s.x, ego, e), np.zeros(12))
    P[:4, :4] += G @ ego.covariance @ G.T
    x = moved(s.x, dt)
    R = rotation_z(float(x[3]))
    for i, f in enumerate(s.f):
        ray = R.T @ (x[:3] - ego.centre) + f
        at = slice(N_BODY + 3 * i, N_BODY + 3 * i + 3)
        P[at, at] += drift[i] * (ray @ ray * np.eye(3) - np.outer(ray, ray))
    return BodyState(x, s.f, P)


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.5])
def test_a_prediction_is_that_of_the_plain_twin(dt: float) -> None:
    rng = np.random.default_rng(1)
    s, ego, drift = ahead(rng), step_of(rng), rng.uniform(0.0, 1e-6, N)
    found, twin = predict_body(s, dt, ROAD, ego, drift), predicted(s, dt, ego, drift)
    np.testing.assert_allclose(found.x, twin.x, atol=1e-12)
    np.testing.assert_array_equal(found.f, s.f)
    np.testing.assert_allclose(found.P, twin.P, atol=1e-8)
    np.testing.assert_allclose(found.P, found.P.T, atol=1e-12)


def test_who_brakes_does_not_go_back() -> None:
    rng = np.random.default_rng(1)
    s = ahead(rng)
    s.x[4:10] = [0.4, 0.0, 0.0, 0.0, -4.0, 0.0]
    still = EgoStep(np.broadcast_to(np.eye(4), (2, 4, 4)).copy(), np.zeros((12, 12)), np.zeros(3))
    found = predict_body(s, 0.5, ROAD, still, np.zeros(N))
    np.testing.assert_array_equal(found.x[4:6], [0.0, 0.0])
    np.testing.assert_array_equal(found.x[:2], s.x[:2])


def projected(state: FloatArray, i: int, T_cam0_world: FloatArray) -> FloatArray:
    """Both views (4,) of feature i of a state vector (11 + 3 n,)."""
    f = state[N_BODY + 3 * i : N_BODY + 3 * i + 3]
    p = se3.apply(T_cam0_world, (state[:3] + rotation_z(float(state[3])) @ f)[None])[0]
    h, J = project_stereo(p, T_CAM1_CAM0)
    along = J[2:] @ p
    h[2:] += state[10] * along / np.linalg.norm(along)
    return h


def updated(s: BodyState, view: StereoView, gates: Gates) -> tuple[BodyState, IntArray]:
    """The plain twin of `update_body`."""
    state, P = np.concatenate([s.x, s.f.ravel()]), s.P.copy()
    status = np.full(len(s.f), UNSEEN)

    def innovation(i: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        m = int(np.isfinite(view.xy[i]).sum())
        H = differences(lambda v: projected(v, i, view.T_cam0_world), state)[:m]
        r = (view.xy[i] - projected(state, i, view.T_cam0_world))[:m]
        S = H @ P @ H.T + np.diag(view.variance[:m])
        return H, r, S, float(r @ np.linalg.solve(S, r))

    at = [i for i in range(len(s.f)) if np.isfinite(view.xy[i, 0])]
    distance = {i: innovation(i) for i in at}
    for i in sorted(at, key=lambda i: distance[i][3] / gates.refuse[len(distance[i][1]) // 2 - 1]):
        H, r, S, squared = innovation(i)
        kind = len(r) // 2 - 1
        if squared > gates.refuse[kind]:
            status[i] = REFUSED
            continue
        status[i] = (LEFT, STEREO)[kind]
        wider = np.sqrt(max(squared / gates.huber[kind], 1.0)) - 1.0
        K = P @ H.T @ np.linalg.inv(S + wider * np.diag(view.variance[: len(r)]))
        state, P = state + K @ r, P - K @ H @ P
    return BodyState(state[:N_BODY], state[N_BODY:].reshape(-1, 3), P), status


def test_an_update_is_that_of_the_plain_twin() -> None:
    """One feature is not seen, one by the left camera alone, one is somewhere else."""
    rng = np.random.default_rng(2)
    s = ahead(rng)
    T_cam0_world = se3.exp(np.array([0.3, -0.2, 0.1, 0.02, -0.03, 0.05]))
    state = np.concatenate([s.x, s.f.ravel()])
    xy = np.array([projected(state, i, T_cam0_world) for i in range(N)])
    xy += rng.normal(0.0, 1e-3, xy.shape)
    xy[1], xy[2, 2:] = np.nan, np.nan
    xy[3] += 0.5
    view = StereoView(xy, T_cam0_world, T_CAM1_CAM0, np.full(4, 1e-6))
    found, status, distance = update_body(s, view, GATES)
    twin, expected = updated(s, view, GATES)
    assert status.tolist() == expected.tolist() == [STEREO, UNSEEN, LEFT, REFUSED, STEREO, STEREO]
    np.testing.assert_allclose(found.x, twin.x, atol=2e-5)
    np.testing.assert_allclose(found.f, twin.f, atol=2e-5)
    np.testing.assert_allclose(found.P, twin.P, atol=2e-5)
    assert np.isinf(distance[1]) and distance[3] > 1.0


def test_a_filtered_body_is_as_sure_as_it_says() -> None:
    """A lateral pass of a body at constant velocity, with the noise that the filter assumes."""
    nees = []
    still = EgoStep(np.broadcast_to(np.eye(4), (2, 4, 4)).copy(), np.zeros((12, 12)), np.zeros(3))
    for seed in range(30):
        rng = np.random.default_rng(seed)
        f = rng.uniform(-1.0, 1.0, (8, 3))
        x = np.zeros(N_BODY)
        x[:3], x[4:6] = [-3.0, 0.0, 10.0], [4.0, 0.0]
        P = np.zeros((N_BODY + 24, N_BODY + 24))
        P[4:7, 4:7], P[7, 7] = np.diag([4.0, 4.0, 0.25]), 0.04
        P[8, 8] = P[9, 9] = 2.25
        P[N_BODY:, N_BODY:] = 0.04 * np.eye(24)
        start = x.copy()
        start[4:7] += rng.normal(0.0, [2.0, 2.0, 0.5])
        s = BodyState(start, f + rng.normal(0.0, 0.2, f.shape), P)
        for k in range(1, 11):
            s = predict_body(s, 0.1, ROAD, still, np.zeros(8))
            p = x[:3] + 0.1 * k * np.array([4.0, 0.0, 0.0]) + f
            h, _ = project_stereo(p, T_CAM1_CAM0)
            view = StereoView(
                h + rng.normal(0.0, 1e-3, h.shape), np.eye(4), T_CAM1_CAM0, np.full(4, 1e-6)
            )
            s, _, _ = update_body(s, view, GATES)
        e = s.x[4:7] - [4.0, 0.0, 0.0]
        nees.append(e @ np.linalg.solve(s.P[4:7, 4:7], e))
    assert 0.3 * 3.0 < np.mean(nees) < 1.5 * 3.0
