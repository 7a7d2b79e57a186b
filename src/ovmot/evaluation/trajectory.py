"""Trajectory errors: absolute (ATE) and relative (RPE), as pure functions of paired poses.

All take N poses T (N, 4, 4) of the truth and of the estimate at the same times. Definitions:
J. Sturm et al., IROS 2012; Z. Zhang and D. Scaramuzza, IROS 2018.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Errors of M poses, or of M pairs of poses: translation (M,) in m, rotation (M,) in rad."""

    translation: FloatArray
    rotation: FloatArray

    def __len__(self) -> int:
        return len(self.translation)


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """What M errors come to, in their unit."""

    rmse: float
    mean: float
    median: float
    maximum: float


def statistics(errors: FloatArray) -> ErrorStatistics | None:
    """Statistics of errors (M,), M > 0; None where there are none."""
    if len(errors) == 0:
        return None
    return ErrorStatistics(
        rmse=float(np.sqrt(np.mean(errors**2))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        maximum=float(np.max(errors)),
    )


def absolute_errors(T_reference: FloatArray, T_estimate: FloatArray) -> PoseErrors:
    """ATE of poses that are aligned already: |p_est - p_ref| and the angle of R_refᵀ R_est."""
    R_reference, R_estimate = T_reference[:, :3, :3], T_estimate[:, :3, :3]
    turn = so3.log(np.swapaxes(R_reference, -1, -2) @ R_estimate)
    return PoseErrors(
        translation=np.linalg.norm(T_estimate[:, :3, 3] - T_reference[:, :3, 3], axis=1),
        rotation=np.linalg.norm(turn, axis=1),
    )


def relative_errors(
    T_reference: FloatArray, T_estimate: FloatArray, first: IntArray, second: IntArray
) -> PoseErrors:
    """RPE over the pairs (`first`, `second`), indices (M,) each; no alignment is needed.

    The error of a pair is (T_ref,1⁻¹ T_ref,2)⁻¹ (T_est,1⁻¹ T_est,2).
    """
    step_reference = se3.inverse(T_reference[first]) @ T_reference[second]
    step_estimate = se3.inverse(T_estimate[first]) @ T_estimate[second]
    return absolute_errors(step_reference, step_estimate)


def pairs_by_time(
    timestamp_ns: IntArray, delta_s: float, tolerance: float = 0.25
) -> tuple[IntArray, IntArray]:
    """Every pose with the first one at least `delta_s` later; indices (M,) of both.

    `timestamp_ns` (N,) rises. Where that one is later by more than the share `tolerance` (poses
    are missing), there is no pair. On even stamps these are the pairs of evo's RPE in frames.
    """
    delta_ns = round(delta_s * 1e9)
    first = np.arange(len(timestamp_ns))
    second = np.searchsorted(timestamp_ns, timestamp_ns + delta_ns)
    kept = second < len(timestamp_ns)
    first, second = first[kept], second[kept]
    near = timestamp_ns[second] - timestamp_ns[first] <= (1.0 + tolerance) * delta_ns
    return first[near], second[near]


def pairs_by_distance(
    T_reference: FloatArray, delta_m: float, tolerance: float = 0.1
) -> tuple[IntArray, IntArray]:
    """Every pose with the later one nearest to `delta_m` along the true path; indices (M,).

    A pair off by more than the share `tolerance` is left out. These are evo's pairs for metres
    with `all_pairs` and `pairs_from_reference`; of poses at the same place the earliest is taken.
    """
    travelled = path_lengths(T_reference)
    n = len(travelled)
    first = np.arange(n - 1)
    after = np.searchsorted(travelled, travelled[:-1] + delta_m)
    before = np.searchsorted(travelled, travelled[np.maximum(after - 1, 0)])
    before, after = np.maximum(before, first + 1), np.clip(after, first + 1, n - 1)
    off_before = np.abs(travelled[before] - travelled[first] - delta_m)
    off_after = np.abs(travelled[after] - travelled[first] - delta_m)
    second = np.where(off_before <= off_after, before, after)
    kept = np.minimum(off_before, off_after) <= tolerance * delta_m
    return first[kept], second[kept]


def path_lengths(T_reference: FloatArray) -> FloatArray:
    """Length (N,) of the path up to each pose, metres."""
    steps = np.linalg.norm(np.diff(T_reference[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def drift_percent(
    T_reference: FloatArray, errors: PoseErrors, first: IntArray, second: IntArray
) -> float | None:
    """Mean translation error of pairs in percent of the path between them (KITTI odometry).

    A. Geiger et al., CVPR 2012. None where there is no pair.
    """
    if len(errors) == 0:
        return None
    travelled = path_lengths(T_reference)
    return float(100.0 * np.mean(errors.translation / (travelled[second] - travelled[first])))


def associate_stamps(
    reference_ns: IntArray, estimate_ns: IntArray, max_gap_ns: int
) -> tuple[IntArray, IntArray]:
    """Indices (M,) into both arrays, a pair each, in order of time.

    `reference_ns` (R,) and `estimate_ns` (E,) rise. A pair is made of stamps at most `max_gap_ns`
    apart, each the nearest to the other (the later one where two are as near), so none is used
    twice.
    """
    if len(reference_ns) == 0 or len(estimate_ns) == 0:
        nothing = np.empty(0, dtype=np.int64)
        return nothing, nothing
    of_estimate = _nearest(reference_ns, estimate_ns)
    of_reference = _nearest(estimate_ns, reference_ns)
    index = np.arange(len(estimate_ns))
    mutual = of_reference[of_estimate] == index
    near = np.abs(reference_ns[of_estimate] - estimate_ns) <= max_gap_ns
    kept = mutual & near
    return of_estimate[kept], index[kept]


def _nearest(stamps_ns: IntArray, wanted_ns: IntArray) -> IntArray:
    """For each wanted stamp (M,), the index of the nearest of `stamps_ns` (N,)."""
    after = np.minimum(np.searchsorted(stamps_ns, wanted_ns), len(stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(wanted_ns - stamps_ns[before]) < np.abs(stamps_ns[after] - wanted_ns)
    index: IntArray = np.where(nearer, before, after)
    return index
