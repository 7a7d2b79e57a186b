"""The moving objects of a run against the truth: every object metric in one flat table."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.evaluation.labels import LabelCounts
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, tracking_sequence
from ovmot.evaluation.object_errors import (
    Latency,
    PairErrors,
    detection_latency,
    pair_errors,
    pull_out_latency,
)
from ovmot.evaluation.stereo_gate import GateCounts
from ovmot.evaluation.tracking import ClearMot, Hota, Identity, clear_mot, hota, identity
from ovmot.geometry.arrays import FloatArray

PULL_OUT_MPS, PULL_OUT_RANGE_M = 2.0, 20.0
"""An object that reaches this speed nearer than this pulls out."""


@dataclass(frozen=True, slots=True)
class ObjectMetrics:
    """How well a run's confirmed tracks meet the true objects."""

    clear: ClearMot
    identity: Identity
    hota: Hota | None
    errors: PairErrors
    latency: Latency
    pull_outs: Latency


def evaluate_objects(frames: tuple[ComparedFrame, ...], criteria: ObjectCriteria) -> ObjectMetrics:
    """All metrics of compared frames, in order of time."""
    sequence = tracking_sequence(frames, criteria.gate_m)
    pulling_out = replace(criteria, min_speed_mps=PULL_OUT_MPS, max_range_m=PULL_OUT_RANGE_M)
    return ObjectMetrics(
        clear_mot(sequence), identity(sequence), hota(sequence),
        pair_errors(frames), detection_latency(frames), pull_out_latency(frames, pulling_out),
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
        "object_length_rmse_m": _rms(errors.size[:, 0]),
        "object_width_rmse_m": _rms(errors.size[:, 1]),
        "object_height_rmse_m": _rms(errors.size[:, 2]),
        "object_distance_mean_m": float(errors.distance.mean()) if len(errors.distance) else None,
        "object_motion_rmse_m": _rms(errors.motion_m),
        "object_motion_rmse_deg": _rms(np.degrees(errors.motion_rad)),
        "object_velocity_nees": _velocity_nees(errors),
        "detection_latency_median_s": _median(latency.seconds),
        "objects_never_found": float(latency.never),
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


def _velocity_nees(errors: PairErrors) -> float | None:
    """Mean NEES of the velocity, of dimension 3, from the stated sigmas alone.

    tracks.csv has no correlations; where a sigma is missing or not positive the pair does not
    count.
    """
    sigma = errors.velocity_sigma
    known = np.isfinite(sigma).all(axis=1) & (sigma > 0.0).all(axis=1)
    if not np.any(known):
        return None
    return float(np.mean(np.sum((errors.velocity_world[known] / sigma[known]) ** 2, axis=1)))


def _rms(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
