"""The compiled filter of one body: the world of a rig that moves in it.

State: place p (3,) of the body's frame in world, its yaw ψ, velocity v (3,), yaw rate ω, level
acceleration a (2,), the error β that its stereo matches have in common, and n features f (n, 3) in
its frame. A feature is at p + R(ψ) f. Roll and pitch stay those of the birth.
tests/objects/test_body_kernel.py holds the plain NumPy twins.
"""

import math
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import inlined_part, part
from ovmot.kernels.small_matrices import factor, solve_lower
from ovmot.kernels.stereo import project, transform

N_BODY = 11
"""Coordinates of the body itself: p, ψ, v, ω, a, β."""
UNSEEN, STEREO, LEFT, REFUSED = 0, 1, 2, 3
"""What became of a feature in an update: not seen, used in both views, in one, refused."""


class BodyState(NamedTuple):
    """x (11,), features f (n, 3) and their joint covariance P (11 + 3 n, 11 + 3 n)."""

    x: FloatArray
    f: FloatArray
    P: FloatArray


class Manoeuvres(NamedTuple):
    """How road users move: standard deviations of level acceleration, m/s², and yaw rate, rad/s,
    their correlation time, s, and the density of upward acceleration, m/s²/√Hz. Of β the standard
    deviation, an angle in rad."""

    accel: float
    yaw_rate: float
    time_s: float
    lift: float
    match: float


class EgoStep(NamedTuple):
    """The rig's step between two frames: poses `T_world_imu` (2, 4, 4), then and now, with their
    joint covariance (12, 12) over rotation (right perturbation) and position of each; the left
    camera's present centre (3,) in world."""

    T_world_imu: FloatArray
    covariance: FloatArray
    centre: FloatArray


class StereoView(NamedTuple):
    """Where the features were seen, `xy` (n, 4), normalized, NaN where not; `T_cam0_world`,
    `T_cam1_cam0` (4, 4); variances (4,) of the coordinates."""

    xy: FloatArray
    T_cam0_world: FloatArray
    T_cam1_cam0: FloatArray
    variance: FloatArray


class Gates(NamedTuple):
    """Squared distances beyond which a feature is refused, and from which its weight falls, for
    two and for four coordinates."""

    refuse: tuple[float, float]
    huber: tuple[float, float]


@part
def predict_body(
    s: BodyState, dt: float, m: Manoeuvres, ego: EgoStep, drift: FloatArray
) -> BodyState:
    """The state after dt seconds.

    `drift` (n,): variances of the angle, rad², by which each feature's patch has drifted across
    its ray. The error of the rig's step moves the body in the world that the rig drifts in.
    """
    B, N = N_BODY, len(s.P)
    out = BodyState(np.empty(B), s.f.copy(), s.P.copy())
    F, Q, FP = np.zeros((B, B)), np.zeros((B, B)), np.empty((B, N))
    transition(s.x, dt, m, out.x, F)
    process_noise(dt, m, math.sqrt(s.x[4] ** 2 + s.x[5] ** 2), Q)
    add_ego_noise(s.x, ego, Q)
    for a in range(B):
        for b in range(N):
            FP[a, b] = 0.0
        for c in range(B):
            if F[a, c] != 0.0:
                for b in range(N):
                    FP[a, b] += F[a, c] * s.P[c, b]
    for a in range(B):
        for b in range(B):
            out.P[a, b] = Q[a, b]
            for c in range(B):
                out.P[a, b] += FP[a, c] * F[b, c]
        for b in range(B, N):
            out.P[a, b] = out.P[b, a] = FP[a, b]
    add_drift(out, ego.centre, drift)
    return out


@part
def transition(x: FloatArray, dt: float, m: Manoeuvres, moved: FloatArray, F: FloatArray) -> None:
    """The state (11,) after dt seconds and its derivative F (11, 11), zero before.

    Yaw rate and acceleration decay with the correlation time; the velocity turns with the yaw.
    """
    decay = math.exp(-dt / m.time_s)
    to_v = m.time_s * (1.0 - decay)
    to_p = m.time_s * (dt - to_v)
    turn = x[7] * to_v
    c, s, ch, sh = math.cos(turn), math.sin(turn), math.cos(0.5 * turn), math.sin(0.5 * turn)
    vx, vy = x[4], x[5]
    for k in range(N_BODY):
        moved[k], F[k, k] = x[k], 1.0
    moved[0] = x[0] + dt * (ch * vx - sh * vy) + to_p * x[8]
    moved[1] = x[1] + dt * (sh * vx + ch * vy) + to_p * x[9]
    moved[2] = x[2] + dt * x[6]
    moved[3] = x[3] + turn
    moved[4] = c * vx - s * vy + to_v * x[8]
    moved[5] = s * vx + c * vy + to_v * x[9]
    stops = vx * moved[4] + vy * moved[5] < 0.0  # who brakes does not go back
    moved[7], moved[8], moved[9] = decay * x[7], decay * x[8], decay * x[9]
    moved[10] = decay * x[10]
    if stops:
        moved[0], moved[1], moved[4], moved[5], moved[8], moved[9] = x[0], x[1], 0.0, 0.0, 0.0, 0.0
    F[0, 4], F[0, 5], F[1, 4], F[1, 5], F[2, 6] = dt * ch, -dt * sh, dt * sh, dt * ch, dt
    F[0, 7] = 0.5 * to_v * dt * (-sh * vx - ch * vy)
    F[1, 7] = 0.5 * to_v * dt * (ch * vx - sh * vy)
    F[0, 8] = F[1, 9] = to_p
    F[3, 7] = to_v
    F[4, 4], F[4, 5], F[5, 4], F[5, 5] = c, -s, s, c
    F[4, 7], F[5, 7] = to_v * (-s * vx - c * vy), to_v * (c * vx - s * vy)
    F[4, 8] = F[5, 9] = to_v
    F[7, 7] = F[8, 8] = F[9, 9] = F[10, 10] = decay


@part
def process_noise(dt: float, m: Manoeuvres, speed: float, Q: FloatArray) -> None:
    """Q (11, 11), zero before, over dt seconds, short against the correlation time.

    First-order Gauss-Markov accelerations (R. Singer, IEEE TAES 1970) and yaw rates. The
    acceleration across its way limits how fast a body turns at its speed.
    """
    q = 2.0 * m.accel**2 / m.time_s
    for k in range(2):
        p, v, a = k, 4 + k, 8 + k
        Q[p, p], Q[v, v], Q[a, a] = q * dt**5 / 20.0, q * dt**3 / 3.0, q * dt
        Q[p, v] = Q[v, p] = q * dt**4 / 8.0
        Q[p, a] = Q[a, p] = q * dt**3 / 6.0
        Q[v, a] = Q[a, v] = q * dt**2 / 2.0
    yaw_rate = min(m.yaw_rate, m.accel / max(speed, 1e-9))
    q = 2.0 * yaw_rate**2 / m.time_s
    Q[10, 10] = m.match**2 * (1.0 - math.exp(-2.0 * dt / m.time_s))
    Q[3, 3], Q[3, 7], Q[7, 3], Q[7, 7] = q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt**2 / 2.0, q * dt
    q = m.lift**2
    Q[2, 2], Q[2, 6], Q[6, 2], Q[6, 6] = q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt**2 / 2.0, q * dt


@part
def add_ego_noise(x: FloatArray, ego: EgoStep, Q: FloatArray) -> None:
    """Add to Q (11, 11) that of place and yaw by the error of the rig's step.

    A rig off by (δθ, δp), R exp(δθ), sees a body that is r from it off by δp - [r]x R δθ in world.
    """
    G, GC = np.zeros((4, 12)), np.zeros((4, 12))
    for k in range(2):
        T, sign = ego.T_world_imu[k], 2.0 * k - 1.0
        rx, ry, rz = x[0] - T[0, 3], x[1] - T[1, 3], x[2] - T[2, 3]
        for c in range(3):
            G[0, 6 * k + c] = -sign * (ry * T[2, c] - rz * T[1, c])
            G[1, 6 * k + c] = -sign * (rz * T[0, c] - rx * T[2, c])
            G[2, 6 * k + c] = -sign * (rx * T[1, c] - ry * T[0, c])
            G[3, 6 * k + c] = sign * T[2, c]
            G[c, 6 * k + 3 + c] = sign
    for a in range(4):
        for b in range(12):
            for c in range(12):
                GC[a, b] += G[a, c] * ego.covariance[c, b]
    for a in range(4):
        for b in range(4):
            for c in range(12):
                Q[a, b] += GC[a, c] * G[b, c]


@part
def add_drift(s: BodyState, centre: FloatArray, drift: FloatArray) -> None:
    """Add the drift of patches across their rays from the camera's centre (3,) to P."""
    c, sn, ray = math.cos(s.x[3]), math.sin(s.x[3]), np.empty(3)
    for i in range(len(s.f)):
        fx, fy = s.f[i, 0], s.f[i, 1]
        x = s.x[0] + c * fx - sn * fy - centre[0]
        y = s.x[1] + sn * fx + c * fy - centre[1]
        ray[0], ray[1], ray[2] = c * x + sn * y, c * y - sn * x, s.x[2] + s.f[i, 2] - centre[2]
        squared, at = ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2, N_BODY + 3 * i
        for a in range(3):
            s.P[at + a, at + a] += drift[i] * squared
            for b in range(3):
                s.P[at + a, at + b] -= drift[i] * ray[a] * ray[b]


class Innovation(NamedTuple):
    """Of one feature: residual (4,), derivatives H (4, 8) by p, ψ, f and β, P Hᵀ as rows (4, N) and
    its covariance S (4, 4)."""

    r: FloatArray
    H: FloatArray
    PH: FloatArray
    S: FloatArray


@part
def update_body(
    s: BodyState, view: StereoView, gates: Gates
) -> tuple[BodyState, IntArray, FloatArray]:
    """The state after a view of its features, what became of each (n,), and their squared
    distances (n,) from the prediction, over the bound beyond which they are refused.

    Features are taken one by one, the nearest to their prediction first; each is tested against
    the state of then.
    """
    n, N = len(s.f), len(s.P)
    out = BodyState(s.x.copy(), s.f.copy(), s.P.copy())
    k = Innovation(np.empty(4), np.empty((4, 8)), np.empty((4, N)), np.empty((4, 4)))
    status, distance = np.zeros(n, np.int64), np.full(n, np.inf)
    for i in range(n):
        used = innovate(out, view, i, k)
        if used > 0:
            distance[i] = squared_distance(k, used) / gates.refuse[used // 2 - 1]
    W, L = np.empty((4, N + 1)), np.empty((4, 4))
    for i in np.argsort(distance):
        used = innovate(out, view, i, k)
        if used > 0 and not squared_distance(k, used) <= gates.refuse[used // 2 - 1]:
            status[i] = REFUSED  # also where it is not a number
        elif used > 0:
            status[i] = LEFT if used == 2 else STEREO
            correct(out, view, i, used, gates.huber[used // 2 - 1], k, W, L)
    return out, status, distance


@part
def innovate(s: BodyState, view: StereoView, i: int, k: Innovation) -> int:
    """The innovation of feature i; how many of its coordinates count: 0, 2 or 4."""
    seen = view.xy[i]
    if not math.isfinite(seen[0] + seen[1]):
        return 0
    c, sn, fx, fy = math.cos(s.x[3]), math.sin(s.x[3]), s.f[i, 0], s.f[i, 1]
    p, q, h, J = np.empty(3), np.empty(3), np.empty(4), np.empty((4, 3))
    p[0], p[1] = s.x[0] + c * fx - sn * fy, s.x[1] + sn * fx + c * fy
    p[2] = s.x[2] + s.f[i, 2]
    transform(view.T_cam0_world, p, q)
    if not q[2] > 0.1:
        return 0
    project(q, view.T_cam1_cam0, h, J)
    T = view.T_cam0_world
    for a in range(4):
        k.r[a] = seen[a] - h[a]
        for b in range(3):
            k.H[a, b] = J[a, 0] * T[0, b] + J[a, 1] * T[1, b] + J[a, 2] * T[2, b]
        x, y = k.H[a, 0], k.H[a, 1]
        k.H[a, 3] = y * (c * fx - sn * fy) - x * (sn * fx + c * fy)
        k.H[a, 4], k.H[a, 5], k.H[a, 6] = c * x + sn * y, c * y - sn * x, k.H[a, 2]
    add_match_error(s.x[10], q, J, k)
    at = N_BODY + 3 * i
    for a in range(4):
        H = k.H[a]
        for b in range(len(s.P)):
            total = H[0] * s.P[0, b] + H[1] * s.P[1, b] + H[2] * s.P[2, b] + H[3] * s.P[3, b]
            total += H[4] * s.P[at, b] + H[5] * s.P[at + 1, b] + H[6] * s.P[at + 2, b]
            total += H[7] * s.P[10, b]
            k.PH[a, b] = total
    for a in range(4):
        PH = k.PH[a]
        for b in range(4):
            H = k.H[b]
            total = PH[0] * H[0] + PH[1] * H[1] + PH[2] * H[2] + PH[3] * H[3]
            total += PH[at] * H[4] + PH[at + 1] * H[5] + PH[at + 2] * H[6]
            total += PH[10] * H[7]
            k.S[a, b] = total
        k.S[a, a] += view.variance[a]
    return 4 if math.isfinite(seen[2] + seen[3]) else 2


@inlined_part
def add_match_error(error: float, q: FloatArray, J: FloatArray, k: Innovation) -> None:
    """Add the matches' common error to the innovation of a point q (3,) in the left camera.

    It moves the right view along the epipolar line, as a greater depth does.
    """
    along0 = J[2, 0] * q[0] + J[2, 1] * q[1] + J[2, 2] * q[2]
    along1 = J[3, 0] * q[0] + J[3, 1] * q[1] + J[3, 2] * q[2]
    length = math.sqrt(along0 * along0 + along1 * along1)
    k.H[0, 7], k.H[1, 7], k.H[2, 7], k.H[3, 7] = 0.0, 0.0, along0 / length, along1 / length
    k.r[2] -= error * k.H[2, 7]
    k.r[3] -= error * k.H[3, 7]


@part
def squared_distance(k: Innovation, used: int) -> float:
    """Squared Mahalanobis distance of the first coordinates that are used."""
    L, x = k.S[:used, :used].copy(), np.empty((used, 1))
    for a in range(used):
        x[a, 0] = k.r[a]
    factor(L)
    solve_lower(L, x)
    total = 0.0
    for a in range(used):
        total += x[a, 0] ** 2
    return total


@inlined_part
def correct(
    s: BodyState, view: StereoView, i: int, used: int, huber: float, k: Innovation, W: FloatArray,
    L: FloatArray,
) -> None:  # fmt: skip
    """Correct the state by feature i: with S = L Lᵀ and W = L⁻¹ H P, P - Wᵀ W.

    Beyond the squared distance `huber` the noise grows, as Huber's weight has it.
    """
    N, squared = len(s.P), squared_distance(k, used)
    wider = math.sqrt(max(squared / huber, 1.0)) - 1.0
    W, L = W[:used], L[:used, :used]
    for a in range(used):
        W[a, N] = k.r[a]
        for b in range(N):
            W[a, b] = k.PH[a, b]
        L[a, :] = k.S[a, :used]
        L[a, a] += wider * view.variance[a]
    factor(L)
    solve_lower(L, W)
    for a in range(used):
        step, row = W[a, N], W[a]
        for b in range(N):
            if b < N_BODY:
                s.x[b] += row[b] * step
            else:
                s.f[(b - N_BODY) // 3, (b - N_BODY) % 3] += row[b] * step
        for b in range(N):
            w = row[b]
            for c in range(N):
                s.P[b, c] -= w * row[c]
