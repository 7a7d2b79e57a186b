"""Dynamic initialization with one camera: the path of the rays, and the scale by the IMU.

The gyroscope gives the rotations R_k, with the bias by which they agree with the images: each pair
of frames has one direction of translation that lies in all epipolar planes (L. Kneip and S. Lynen,
"Direct optimization of frame-to-frame rotation", ICCV 2013). Then every view is linear in its point
and in the position of the camera. With the points eliminated, the rays alone give the path up to
its scale; where that fails, the path is the one that the IMU allows, v t_k + g t_k²/2 + α_k +
R_k p_cam with α_k from the accelerometer and |g| known (T.-C. Dong-Si and A. Mourikis, "Estimator
initialization in vision-aided inertial navigation with unknown camera-IMU calibration", IROS 2012).
Scale, velocity and gravity are those by which the IMU measures the path. The accelerometer's bias
is left to the bundle adjustment.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.stereo_motion import MIN_POINTS
from ovmot.geometry.triangulation import inverse_3x3
from ovmot.initialization.dynamic import (
    DynamicSolution,
    InitializationPrior,
    preintegrate_from_first,
)
from ovmot.initialization.static import gravity_aligned_rotation
from ovmot.physics import GYRO_BIAS_SIGMA_RPS, tracked_pixel_sigma
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.propagation import Propagation
from ovmot.vio.state import GYRO_BIAS, THETA, ImuState

_LEAST_VIEWS = 4
_PAIR_S = 0.4  # between the frames of a pair: parallax beyond noise, in tracks that last so long
_LEAST_DEPTH = 1e-3  # in units of the path's root mean square distance
_LEAST_SHARE = 0.5  # of the points: what most of them show is the world


@dataclass(frozen=True, slots=True)
class _Tracks:
    """Bearings of F points in K frames: `xy` (K, F, 2) normalized, NaN where unseen."""

    feature_id: IntArray
    xy: FloatArray

    @property
    def seen(self) -> BoolArray:
        """Which points (K, F) a frame has seen."""
        return np.isfinite(self.xy[..., 0])

    @property
    def rays(self) -> FloatArray:
        """Unit vectors (K, F, 3) in the camera."""
        rays = np.concatenate([self.xy, np.ones((*self.xy.shape[:2], 1))], axis=-1)
        out: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return out


def monocular_initialization(
    frames: Sequence[FrontendFrame],
    imu: Sequence[ImuData],
    rig: StereoRig,
    noise: ImuNoise,
    prior: InitializationPrior,
) -> DynamicSolution:
    """The initial state by the left features of K frames and the K - 1 IMU intervals between them.

    Raises `InitializationError` where too few points are tracked or agree.
    """
    tracks = _tracks(frames)
    if len(tracks.feature_id) < MIN_POINTS:
        raise InitializationError(
            f"{len(tracks.feature_id)} points tracked over the window (at least {MIN_POINTS})"
        )
    sigma = tracked_pixel_sigma(len(frames) / 2) / rig.cam0.fx
    R_imu_cam = rig.T_imu_cam0[:3, :3]
    bias = gyro_bias_of_rays(tracks.rays, imu, R_imu_cam, noise, sigma)
    motion = preintegrate_from_first(imu, bias, noise)
    stamps = [imu[0].timestamp_ns[0], *(samples.timestamp_ns[-1] for samples in imu)]
    t = 1e-9 * (np.array(stamps) - stamps[0])
    R = np.array([np.eye(3), *(m.imu.R_world_imu for m in motion)])
    alpha = np.array([np.zeros(3), *(m.imu.position for m in motion)])
    moved = alpha + (R - np.eye(3)) @ rig.T_imu_cam0[:3, 3]
    path, aligned = _path_and_scale(tracks, t, R @ R_imu_cam, moved, sigma, prior.gravity)
    v, g, zero = aligned.velocity, aligned.gravity, np.zeros(3)
    p = v * t[:, None] + 0.5 * g * t[:, None] ** 2 + alpha
    R_world_first = gravity_aligned_rotation(-g)
    first = ImuState(R_world_first, zero, R_world_first @ v, bias, zero)
    T = se3.make(R_world_first, zero) @ se3.make(R, p)
    return DynamicSolution(first, T, tracks.feature_id[path.agree])


def _path_and_scale(
    tracks: _Tracks,
    t: FloatArray,
    R_first_cam: FloatArray,
    moved: FloatArray,
    sigma: float,
    gravity: float,
) -> tuple["_Path", "_Alignment"]:
    """The first path of the two that agrees with enough points, and how the IMU measures it."""
    reasons: list[str] = []
    for solve in (_by_rays, _by_imu(t, moved, gravity)):
        path = _camera_path(tracks, R_first_cam, sigma, solve)
        aligned = _aligned_with_imu(path.position, t, moved, gravity)
        agree, of = int(path.agree.sum()), len(path.agree)
        least = max(MIN_POINTS, round(_LEAST_SHARE * of))
        if agree < least:
            reasons.append(f"{agree} of {of} points agree on a path (at least {least})")
        elif not aligned.scale > 0.0:
            reasons.append("one camera needs accelerations to know the scale")
        else:
            return path, aligned
    raise InitializationError("; ".join(dict.fromkeys(reasons)))


def _tracks(frames: Sequence[FrontendFrame], most: int = 200) -> _Tracks:
    """The longest tracks of the left camera, at most `most`."""
    seen = [np.isfinite(frame.normalized[:, 0]) for frame in frames]
    all_ids = [frame.feature_id[ok] for frame, ok in zip(frames, seen, strict=True)]
    ids, counts = np.unique(np.concatenate(all_ids), return_counts=True)
    longest = np.argsort(-counts, kind="stable")[:most]
    ids = np.sort(ids[longest[counts[longest] >= _LEAST_VIEWS]])
    xy = np.full((len(frames), len(ids), 2), np.nan)
    for k, frame in enumerate(frames):
        _, column, row = np.intersect1d(ids, frame.feature_id, return_indices=True)
        xy[k, column] = frame.normalized[row, :2]
    return _Tracks(ids, xy)


def gyro_bias_of_rays(
    rays: FloatArray,
    imu: Sequence[ImuData],
    R_imu_cam: FloatArray,
    noise: ImuNoise,
    sigma: float,
    *,
    iterations: int = 8,
) -> FloatArray:
    """The gyroscope's bias (3,), rad/s, by unit vectors `rays` (K, F, 3) in the camera, NaN where
    unseen; `sigma`: their standard deviation, rad.

    Gauss-Newton on t · (f_j x R_jk f_k) over pairs of frames, with the direction t of each pair's
    translation eliminated, and the loss of S. Geman and D. McClure.
    """
    bias = np.zeros(3)
    for _ in range(iterations):
        motion = preintegrate_from_first(imu, bias, noise)
        N, b = np.eye(3) / GYRO_BIAS_SIGMA_RPS**2, -bias / GYRO_BIAS_SIGMA_RPS**2
        for j, k in _pairs(imu):
            N_pair, b_pair = _pair_equations(rays[j], rays[k], motion, (j, k), R_imu_cam, sigma)
            N, b = N + N_pair, b + b_pair
        step = np.linalg.solve(N, b)
        bias = bias + step
        if np.linalg.norm(step) < 1e-5:
            break
    return bias


def _pairs(imu: Sequence[ImuData]) -> list[tuple[int, int]]:
    """Pairs of frames `_PAIR_S` apart, or next to each other where frames are slower."""
    ends = np.array([imu[0].timestamp_ns[0], *(samples.timestamp_ns[-1] for samples in imu)])
    later = np.searchsorted(ends, ends + round(1e9 * _PAIR_S))
    return [(j, max(int(k), j + 1)) for j, k in enumerate(later) if max(k, j + 1) < len(ends)]


def _pair_equations(
    f_j: FloatArray,
    f_k: FloatArray,
    motion: Sequence[Propagation],
    pair: tuple[int, int],
    R_imu_cam: FloatArray,
    sigma: float,
) -> tuple[FloatArray, FloatArray]:
    """JᵀJ (3, 3) and -Jᵀr (3,) of one pair of frames by the gyroscope's bias."""
    both = np.isfinite(f_j + f_k).all(axis=1)
    f_j, f_k = f_j[both], f_k[both]
    if len(f_j) < MIN_POINTS:
        return np.zeros((3, 3)), np.zeros(3)
    R_first, by_bias = zip(*(_rotation(motion, i) for i in pair), strict=True)
    R = R_imu_cam.T @ R_first[0].T @ R_first[1] @ R_imu_cam
    # R_jk exp(φ): what the bias turns at k, less what it turned at j
    turn = R_imu_cam.T @ (by_bias[1] - R_first[1].T @ R_first[0] @ by_bias[0])
    n = np.cross(f_j, f_k @ R.T)
    weight = np.ones(len(n))
    for _ in range(3):
        directions = np.linalg.eigh((n * weight[:, None]).T @ n)[1]
        r = n @ directions[:, 0]
        weight = 1.0 / (1.0 + (r / (2.0 * sigma)) ** 2) ** 2
    J = -np.cross(directions[:, 0], f_j) @ R
    J = np.cross(J, f_k) @ turn
    by_direction = n @ directions[:, 1:]
    w = weight[:, None] / (2.0 * sigma**2)
    A, B = by_direction.T @ (w * by_direction), by_direction.T @ (w * J)
    A = A + 1e-9 * np.trace(A) * np.eye(2) + np.eye(2)
    reduced = J - by_direction @ np.linalg.solve(A, B)
    return J.T @ (w * reduced), -reduced.T @ (w[:, 0] * r)


def _rotation(motion: Sequence[Propagation], frame: int) -> tuple[FloatArray, FloatArray]:
    """R_first_k and its derivative by the gyroscope's bias, on the right."""
    if frame == 0:
        return np.eye(3), np.zeros((3, 3))
    m = motion[frame - 1]
    return m.imu.R_world_imu, m.transition[THETA, GYRO_BIAS]


@dataclass(frozen=True, slots=True)
class _Path:
    """Positions (K, 3) of the camera, relative to the first one; which points (F,) agree."""

    position: FloatArray
    agree: BoolArray


_Solve = Callable[[FloatArray], FloatArray]
"""Positions (K, 3) of the least cost xᵀN x, from N (3 K, 3 K)."""


def _by_rays(N: FloatArray) -> FloatArray:
    """Positions relative to the first, of root mean square 1: the scale of rays is free."""
    position = np.zeros((len(N) // 3, 3))
    position[1:] = np.linalg.eigh(N[3:, 3:])[1][:, 0].reshape(-1, 3)
    return np.asarray(position * np.sqrt(len(position)))


def _by_imu(t: FloatArray, moved: FloatArray, gravity: float) -> _Solve:
    """Positions v t + g t²/2 + `moved` (K, 3), with v and g of the least cost and |g| known."""
    G = np.kron(np.stack([t, 0.5 * t**2], axis=1), np.eye(3))

    def solve(N: FloatArray) -> FloatArray:
        x = _with_gravity_known(G.T @ N @ G, -G.T @ N @ moved.ravel(), gravity)
        return np.asarray((G @ x).reshape(-1, 3) + moved)

    return solve


def _camera_path(
    tracks: _Tracks, R_first_cam: FloatArray, sigma: float, solve: _Solve, *, iterations: int = 8
) -> _Path:
    """The camera's path with known rotations `R_first_cam` (K, 3, 3).

    With the points eliminated, the cost of the views is quadratic in the positions. Views are
    weighted by depth and by a robust loss, anew at each iteration.
    """
    seen = tracks.seen
    xy = np.where(seen[..., None], tracks.xy, 0.0)
    R_cam = np.swapaxes(R_first_cam, 1, 2)
    A = R_cam[:, None, :2, :] - xy[..., None] * R_cam[:, None, 2:, :]  # (K, F, 2, 3)
    square_of = np.einsum("kfai,kfaj->kfij", A, A)
    weight = seen.astype(np.float64)
    position, agree = np.zeros((len(seen), 3)), np.zeros(seen.shape[1], dtype=np.bool_)
    for _ in range(iterations):
        S = square_of * weight[..., None, None]
        V_inverse = inverse_3x3(S.sum(axis=0) + 1e-12 * np.eye(3))
        position = solve(_reduced(S, V_inverse))
        p = (V_inverse @ np.einsum("kfij,kj->fi", S, position)[..., None])[..., 0]
        q = np.einsum("kij,kfj->kfi", R_cam, p[None] - position[:, None])
        if np.median(q[..., 2][seen]) < 0.0:  # rays alone do not tell forwards from backwards
            position, p, q = -position, -p, -q
        error = np.linalg.norm(np.einsum("kfai,kfi->kfa", A, p[None] - position[:, None]), axis=-1)
        least = _LEAST_DEPTH * np.sqrt((position**2).mean())
        depth = np.maximum(np.abs(q[..., 2]), least)
        square = np.where(seen, (error / (depth * sigma)) ** 2, 0.0).sum(axis=0)
        square = square / (2.0 * seen.sum(axis=0))
        ahead = (np.where(seen, q[..., 2], np.inf) > 0.0).all(axis=0)
        scale = max(float(np.median(square)), 1.0)
        weight = seen / (1.0 + square / scale) ** 2 / depth**2
        agree = ahead & (square < 9.0 * scale)
    return _Path(position, agree)


def _reduced(S: FloatArray, V_inverse: FloatArray) -> FloatArray:
    """The cost (3 K, 3 K) of positions, points eliminated: views S (K, F, 3, 3), V⁻¹ (F, 3, 3)."""
    n = 3 * len(S)
    W = np.moveaxis(S, 0, 1).transpose(0, 2, 1, 3).reshape(S.shape[1], 3, n)
    N: FloatArray = -np.einsum("fin,fim->nm", W, V_inverse @ W, optimize=True)
    for k, block in enumerate(S.sum(axis=1)):
        N[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += block
    return N


@dataclass(frozen=True, slots=True)
class _Alignment:
    """Scale of the path; velocity and gravity (3,) in the first IMU frame."""

    scale: float
    velocity: FloatArray
    gravity: FloatArray


def _aligned_with_imu(
    path: FloatArray, t: FloatArray, moved: FloatArray, gravity: float
) -> _Alignment:
    """scale · path (K, 3) = v t + g t²/2 + `moved` (K, 3) by least squares, with |g| known."""
    eye = np.eye(3)
    A = np.zeros((len(t), 3, 7))
    A[:, :, 0] = -path
    A[:, :, 1:4], A[:, :, 4:] = t[:, None, None] * eye, 0.5 * t[:, None, None] ** 2 * eye
    J, r = A.reshape(-1, 7), -moved.ravel()
    x = _with_gravity_known(J.T @ J, J.T @ r, gravity)
    return _Alignment(float(x[0]), x[1:4], x[4:])


def _with_gravity_known(N: FloatArray, b: FloatArray, gravity: float) -> FloatArray:
    """The minimum of xᵀN x - 2 bᵀx over x (n,), of which the last three are g, with |g| known.

    With the others eliminated, (D + λ) g = d; the least cost is at the one λ above minus the least
    eigenvalue of D for which |g| is right: it is found by bisection.
    """
    by_others = np.linalg.solve(N[:-3, :-3], np.column_stack([N[:-3, -3:], b[:-3]]))
    D, d = N[-3:, -3:] - N[-3:, :-3] @ by_others[:, :3], b[-3:] - N[-3:, :-3] @ by_others[:, 3]
    values, Q = np.linalg.eigh(0.5 * (D + D.T))
    c = Q.T @ d
    low, high = -values[0], -values[0] + np.linalg.norm(d) / gravity
    for _ in range(80):
        middle = 0.5 * (low + high)
        if np.linalg.norm(c / (values + middle)) > gravity:
            low = middle
        else:
            high = middle
    g = Q @ (c / (values + high))
    return np.concatenate([by_others[:, 3] - by_others[:, :3] @ g, g])
