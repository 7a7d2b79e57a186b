"""Accelerometer against stereo: the length of the baseline, the sign of the accelerometer.

Stereo measures how far the camera goes in units of its baseline, the accelerometer in metres. Over
a stretch, the displacements d of the camera by stereo and those by the IMU differ by a factor u:

    d_k = u ([P]_k + [R]_k p_imu_cam) + v [t]_k + g [t²/2]_k

with [.]_k the change over the k-th interval, R the gyroscope's rotation since the stretch began, P
the double integral of R a, and v and g free: the velocity at the start and gravity with the bias.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.doctor.camera_rotations import CameraRotations
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Finding, Severity
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuData

_LEAST_INTERVALS = 12
_HUBER = 1.5
_ROUNDS = 8
_SIGMAS = 4.0
_OFF = (0.05, 0.15)  # a tape measures a baseline to a few percent
_SPARSE_S = 0.05  # samples farther apart: what lies between is a straight line, and twice as unsure
_SURE = 0.1  # a factor whose standard deviation is greater is not reported


@dataclass(frozen=True, slots=True)
class StereoScale:
    """How much longer stereo's displacements are than the IMU's, and its standard deviation."""

    factor: float
    std: float


def check_scale(
    found: StereoScale | None, rig: StereoRig, period_s: float, locations: Locations
) -> Finding:
    """Finding about the baseline; `period_s`: interval of the IMU's samples."""
    check = "stereo scale"
    if found is None:
        says = "no stretch of frames whose motion the images tell"
        return Finding(check, Severity.UNKNOWN, says)
    u, std = found.factor, found.std
    if not std < _SURE * max(abs(u), 1.0):
        says = f"the rig accelerates too little (the factor is sure to {std:.2g})"
        return Finding(check, Severity.UNKNOWN, says)
    if u < -_SIGMAS * std:
        says = f"the accelerometer says the opposite of what the images say ({u:.2f} ± {std:.2g})"
        remedy = f"it is negated: multiply the accelerations in {locations.imu} by -1"
        fix = {"recording.accel_scale": -1.0}
        return Finding("accelerometer sign", Severity.WRONG, says, remedy, fix)
    says = f"stereo measures {u:.3g} times the motion that the accelerometer says (± {std:.2g})"
    doubtful, wrong = (max(s * (1 + (period_s > _SPARSE_S)), _SIGMAS * std) for s in _OFF)
    off = max(u, 1.0 / max(u, 1e-3)) - 1.0
    if off <= doubtful:
        return Finding(check, Severity.FINE, says)
    agrees_m = rig.baseline / max(u, 1e-3)
    remedy = (
        f"the baseline is {rig.baseline:.4g} m by the calibration, {agrees_m:.3g} m would agree:"
        f" correct {locations.extrinsics}, or how far the cameras look inwards"
    )
    return Finding(check, Severity.WRONG if off > wrong else Severity.DOUBTFUL, says, remedy)


def fit_scale(
    turns: CameraRotations, imu: ImuData, rig: StereoRig, offset_s: float
) -> StereoScale | None:
    """The factor u over all stretches; `offset_s`: t_imu - t_cam as it is.

    None where no stretch has enough intervals that the IMU covers.
    """
    parts = [_equations(part, imu, rig, offset_s) for part in _stretches(turns)]
    known = [part for part in parts if part is not None]
    if not known:
        return None
    n = 1 + 6 * len(known)
    A, b = [], []
    for i, (own, by_factor, displacement) in enumerate(known):
        rows = np.zeros((len(displacement), n))
        rows[:, 0], rows[:, 1 + 6 * i : 7 + 6 * i] = by_factor, own
        A.append(rows)
        b.append(displacement)
    return _solve(np.concatenate(A), np.concatenate(b))


def _stretches(turns: CameraRotations) -> Sequence[CameraRotations]:
    """Runs of intervals that follow each other and that the images tell."""
    known = np.isfinite(turns.rotation[:, 0])
    joined = known[1:] & known[:-1] & (turns.end_ns[:-1] == turns.start_ns[1:])
    groups = np.split(np.arange(len(known)), np.flatnonzero(~joined) + 1)
    return [turns.rows(g) for g in groups if len(g) >= _LEAST_INTERVALS]


def _equations(
    turns: CameraRotations, imu: ImuData, rig: StereoRig, offset_s: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Of a stretch of K intervals: columns (3K, 6) of v and g, that of u (3K,), d (3K,)."""
    edges_ns = np.append(turns.start_ns, turns.end_ns[-1])
    origin = int(edges_ns[0])
    edges = 1e-9 * (edges_ns - origin)
    at = 1e-9 * (imu.timestamp_ns - origin) - offset_s
    if at[0] > edges[0] or at[-1] < edges[-1]:
        return None
    inside = at[(at > edges[0]) & (at < edges[-1])]
    times = np.union1d(edges, inside)
    gyro, accel = (
        np.stack([np.interp(times, at, x) for x in v.T], axis=1) for v in (imu.gyro, imu.accel)
    )
    R_imu_cam, p_imu_cam = rig.T_imu_cam0[:3, :3], rig.T_imu_cam0[:3, 3]
    steps = np.diff(times)[:, None]
    k = np.searchsorted(times, edges)
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (gyro[1:] + gyro[:-1]) * steps, 0)])
    seen = turns.rotation @ R_imu_cam.T
    bias = np.median((np.diff(angle[k], axis=0) - seen) / np.diff(edges)[:, None], axis=0)
    rotations = [np.eye(3)]
    for turn in so3.exp((0.5 * (gyro[1:] + gyro[:-1]) - bias) * steps):
        rotations.append(rotations[-1] @ turn)
    R = np.array(rotations)
    force = np.einsum("nij,nj->ni", R, accel)
    speed = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (force[1:] + force[:-1]) * steps, 0)])
    moved = 0.5 * (speed[1:] + speed[:-1]) * steps - (force[1:] - force[:-1]) * steps**2 / 12.0
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)]) + R @ p_imu_cam
    by_factor = np.diff(path[k], axis=0)
    displacement = np.einsum("nij,nj->ni", R[k[:-1]] @ R_imu_cam, turns.translation)
    t = np.stack([np.diff(edges), 0.5 * np.diff(edges**2)], axis=1)
    own = np.einsum("kc,ij->kicj", t, np.eye(3)).reshape(-1, 6)
    return own, by_factor.ravel(), displacement.ravel()


def _solve(A: FloatArray, b: FloatArray) -> StereoScale:
    """Least squares with Huber weights."""
    weight: FloatArray = np.ones(len(b))
    x: FloatArray = np.zeros(A.shape[1])
    for _ in range(_ROUNDS):
        x = np.asarray(np.linalg.lstsq(A * weight[:, None], b * weight, rcond=None)[0])
        off: FloatArray = np.abs(b - A @ x)
        sigma = max(1.4826 * float(np.median(off)), 1e-9)
        weight = np.asarray(np.sqrt(np.minimum(1.0, _HUBER * sigma / np.maximum(off, 1e-12))))
    noise = float(((weight * (b - A @ x)) ** 2).sum()) / max(len(b) - A.shape[1], 1)
    J = A * weight[:, None]
    return StereoScale(float(x[0]), float(np.sqrt(noise * np.linalg.pinv(J.T @ J)[0, 0])))
