"""The metrics to read first, and what they say in plain words."""

from collections.abc import Mapping

HEADLINE_ROWS = 8
HEADLINES: dict[str, str] = {
    "ate_yaw_m": "position error over the run, RMS, m",
    "ate_percent": "the same, as a share of the way, %",
    "ate_yaw_deg": "error of the attitude over the run, RMS, degrees",
    "object_recall": "share of the moving objects found, over all frames",
    "object_precision": "share of the reported objects that are real",
    "idf1": "share of the frames in which objects keep one id",
    "object_velocity_rmse_mps": "error of the objects' velocity, RMS, m/s",
    "false_tracks_per_min": "tracks on nothing that moves, a minute",
    "confirmed_tracks_per_min": "tracks a minute; what they are on is not known",
    "rpe_1s_m": "position error over one second, RMS, m",
    "nees_pose": "squared error over stated covariance; 6 if they agree",
    "first_pose_s": "from the first stamp to the first pose, s",
    "standstill_drift_m": "drift while standing, m",
    "stereo_precision": "share of the accepted stereo matches that are right",
}
"""What a table shows first, in this order, as far as it is there: `HEADLINE_ROWS` of them."""
NOTES: dict[str, str] = {
    "ate_se3_deg": "fits positions only: any roll about a straight way fits; see ate_yaw_deg",
    "ate_sim3_deg": "as ate_se3_deg",
    "nees_orientation": "3 if errors and covariance agree",
    "nees_position": "3 if errors and covariance agree",
    "nees_position_with_truth": "the same, with the truth's own accuracy",
    "object_velocity_nees": "3 if errors and sigmas agree",
    "object_position_nees": "3 if errors and sigmas agree",
    "object_size_nees": "3 if errors and sigmas agree",
    "object_heading_nees": "1 if errors and sigmas agree",
    "object_yaw_rate_nees": "1 if errors and sigmas agree",
    "centre_acceleration_ratio": "how many times as rough as the true ways; 1 is as smooth",
}
"""What is said beside other metrics where all are shown."""


def headline(scalars: Mapping[str, float | None]) -> list[str]:
    """Names of the metrics to read first, at most `HEADLINE_ROWS`, each with a value.

    `confirmed_tracks_per_min` is for runs whose objects are not known; else false tracks are
    counted.
    """
    known = [name for name in HEADLINES if scalars.get(name) is not None]
    if "false_tracks_per_min" in known:
        known.remove("confirmed_tracks_per_min")
    return known[:HEADLINE_ROWS]
