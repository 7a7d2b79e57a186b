"""The moving objects of a run against the truth: every object metric in one flat table."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.evaluation.labels import LabelCounts
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, tracking_sequence
from ovmot.evaluation.object_errors import (
    Latency,
    PairErrors,
    detection_latency,
    pair_errors,
    pull_out_latency,
)
from ovmot.evaluation.object_views import two_sides_seen, whole_in_view
from ovmot.evaluation.stereo_gate import GateCounts
from ovmot.evaluation.track_quality import (
    DISTANCES_M,
    Confirmation,
    FalseTracks,
    Smoothness,
    centre_accelerations,
    confirmation_latency,
    count_false_tracks,
)
from ovmot.evaluation.tracking import ClearMot, Hota, Identity, clear_mot, hota, identity
from ovmot.geometry.arrays import BoolArray, FloatArray

PULL_OUT_MPS, PULL_OUT_RANGE_M = 2.0, 20.0
"""An object that reaches this speed nearer than this pulls out."""
LEAST_ACCELERATION_MPS2 = 0.1
"""Below this the true bodies drive evenly, and nothing can be compared with their acceleration."""


@dataclass(frozen=True, slots=True)
class ObjectMetrics:
    """How well a run's confirmed tracks meet the true objects.

    `two_sides` (M,): of which pairs of `errors` the rig has seen two neighbouring sides, the body
    whole in view.
    `confirmation` is None where the left camera is not known.
    """

    clear: ClearMot
    identity: Identity
    hota: Hota | None
    errors: PairErrors
    two_sides: BoolArray
    latency: Latency
    pull_outs: Latency
    smoothness: Smoothness
    false_tracks: FalseTracks
    confirmation: Confirmation | None


def evaluate_objects(
    frames: tuple[ComparedFrame, ...],
    criteria: ObjectCriteria,
    left: tuple[Camera, FloatArray] | None = None,
) -> ObjectMetrics:
    """All metrics of compared frames, in order of time.

    `left`: the left camera and its `T_cam0_imu` (4, 4), where they are known.
    """
    sequence = tracking_sequence(frames, criteria.gate_m)
    pulling_out = replace(criteria, min_speed_mps=PULL_OUT_MPS, max_range_m=PULL_OUT_RANGE_M)
    if left is None:
        in_view = tuple(frame.objects.visible_px >= criteria.min_pixels for frame in frames)
    else:
        in_view = whole_in_view(frames, *left)
    sides = two_sides_seen(frames, in_view)
    of_pairs = [seen[frame.pairs[:, 0]] for frame, seen in zip(frames, sides, strict=True)]
    confirmation = None if left is None else confirmation_latency(frames, in_view)
    return ObjectMetrics(
        clear_mot(sequence), identity(sequence), hota(sequence),
        pair_errors(frames), np.concatenate(of_pairs), detection_latency(frames),
        pull_out_latency(frames, pulling_out), centre_accelerations(frames),
        count_false_tracks(frames), confirmation,
    )  # fmt: skip


def object_scalars(metrics: ObjectMetrics) -> dict[str, float | None]:
    """One flat table, names ending in the unit; None where there is nothing to measure."""
    clear, errors, latency, h = metrics.clear, metrics.errors, metrics.latency, metrics.hota
    velocity = np.linalg.norm(errors.velocity[:, :2], axis=1)
    pulls = metrics.pull_outs
    return {
        "object_boxes": float(clear.n_true),
        "object_recall": clear.recall,
        "object_precision": clear.precision,
        "false_boxes": float(clear.false_positives),
        "mota": clear.mota,
        "motp": clear.motp,
        "id_switches": float(clear.id_switches),
        "fragmentations": float(clear.fragmentations),
        "mostly_tracked": float(clear.mostly_tracked),
        "mostly_lost": float(clear.mostly_lost),
        "idf1": metrics.identity.idf1,
        "hota": None if h is None else float(h.hota.mean()),
        "hota_detection": None if h is None else float(h.detection.mean()),
        "hota_association": None if h is None else float(h.association.mean()),
        "object_velocity_rmse_mps": _rms(velocity),
        "object_velocity_median_mps": _median(velocity),
        "object_speed_rmse_mps": _rms(errors.speed),
        "object_yaw_rate_rmse_dps": _rms(np.degrees(errors.yaw_rate)),
        "object_heading_rmse_deg": _rms(np.degrees(errors.heading)),
        **_size_scalars("object", errors.size),
        "two_sides_boxes": float(metrics.two_sides.sum()),
        **_size_scalars("two_sides", errors.size[metrics.two_sides]),
        "object_distance_mean_m": float(errors.distance.mean()) if len(errors.distance) else None,
        "object_position_rmse_m": _rms(np.linalg.norm(errors.position_world, axis=1)),
        "object_motion_rmse_m": _rms(errors.motion_m),
        "object_motion_rmse_deg": _rms(np.degrees(errors.motion_rad)),
        **_consistency_scalars(errors),
        **_smoothness_scalars(metrics.smoothness),
        "false_tracks": float(metrics.false_tracks.false),
        "false_tracks_per_min": metrics.false_tracks.per_minute,
        "detection_latency_median_s": _median(latency.seconds),
        "objects_never_found": float(latency.never),
        **_confirmation_scalars(metrics.confirmation),
        "pull_outs": float(len(pulls.seconds) + pulls.never),
        "pull_out_latency_median_s": _median(pulls.seconds),
        "pull_outs_never_found": float(pulls.never),
    }


def label_scalars(counts: LabelCounts) -> dict[str, float | None]:
    """Precision and recall of the label `dynamic`, the share of resting points kept, and the number
    of points."""
    return {
        "point_precision": counts.precision,
        "point_recall": counts.recall,
        "static_kept": counts.static_kept,
        "points_a_frame": counts.a_frame,
    }


def gate_scalars(counts: GateCounts) -> dict[str, float | None]:
    """Precision and recall of the stereo gate, and the share of wrong matches that it refuses."""
    return {
        "stereo_precision": counts.precision,
        "stereo_recall": counts.recall,
        "stereo_wrong_refused": counts.wrong_refused_share,
    }


def _size_scalars(group: str, size: FloatArray) -> dict[str, float | None]:
    names = ("length", "width", "height")
    return {f"{group}_{name}_rmse_m": _rms(size[:, k]) for k, name in enumerate(names)}


def _consistency_scalars(errors: PairErrors) -> dict[str, float | None]:
    sigma = errors.box_sigma
    return {
        "object_velocity_nees": _nees(errors.velocity_world, errors.velocity_sigma),
        "object_position_nees": _nees(errors.position_world, errors.position_sigma),
        "object_size_nees": _nees(errors.size, sigma[:, :3]),
        "object_heading_nees": _nees(errors.heading[:, None], sigma[:, 3:4]),
        "object_yaw_rate_nees": _nees(errors.yaw_rate[:, None], sigma[:, 4:]),
    }


def _smoothness_scalars(smooth: Smoothness) -> dict[str, float | None]:
    """95th percentiles of the centres' accelerations, and how many times the true one."""
    reported = true = ratio = None
    if len(smooth.true):
        reported, true = (float(np.percentile(a, 95.0)) for a in (smooth.reported, smooth.true))
        ratio = reported / true if true > LEAST_ACCELERATION_MPS2 else None
    return {
        "centre_acceleration_p95_mps2": reported,
        "true_acceleration_p95_mps2": true,
        "centre_acceleration_ratio": ratio,
    }


def _confirmation_scalars(confirmation: Confirmation | None) -> dict[str, float | None]:
    """The median latency, over all objects and by their distance; and those never confirmed."""
    if confirmation is None:
        return {}
    near = (0.0, *DISTANCES_M[:-1])
    return {
        "confirmation_latency_median_s": confirmation.median(),
        **{
            f"confirmation_latency_{start:g}_to_{end:g}_m_s": confirmation.median(start, end)
            for start, end in zip(near, DISTANCES_M, strict=True)
        },
        "objects_never_confirmed": float(confirmation.never),
    }


def _nees(error: FloatArray, sigma: FloatArray) -> float | None:
    """Mean NEES of errors (M, D), of dimension D, from the stated sigmas (M, D) alone.

    tracks.csv has no correlations; where a sigma is missing or not positive the pair does not
    count.
    """
    known = np.isfinite(sigma).all(axis=1) & (sigma > 0.0).all(axis=1)
    if not np.any(known):
        return None
    return float(np.mean(np.sum((error[known] / sigma[known]) ** 2, axis=1)))


def _rms(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
