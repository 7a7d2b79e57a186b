"""Read a finished run back, and hold it against the truth where there is one.

python examples/read_run.py RUN [TRUTH]
"""

import sys

import numpy as np

import ovmot


def main(folder: str, truth: str | None = None) -> dict[str, float]:
    """Print what the run found, and return it by name."""
    run = ovmot.Run(folder)
    stamps, T_world_imu = run.trajectory.timestamp_ns, run.trajectory.T_world_imu
    steps = np.linalg.norm(np.diff(T_world_imu[:, :3, 3], axis=0), axis=1)
    found = {
        "frames": float(len(stamps)),
        "seconds": 1e-9 * float(stamps[-1] - stamps[0]),
        "path_m": float(steps.sum()),
        "last_sigma_m": float(np.sqrt(np.trace(run.covariance[-1, 3:6, 3:6]))),
        "gyro_bias_x": float(run.state["gyro_bias_x"][-1]),
    }
    confirmed = run.tracks[run.tracks["state"] == "confirmed"]
    for track_id in np.unique(confirmed["track_id"]):
        rows = confirmed[confirmed["track_id"] == track_id]
        speed = np.hypot(rows["vx"], rows["vy"])
        print(f"object {track_id}: seen in {len(rows)} frames, {speed.mean():.1f} m/s")
    found["objects"] = float(len(np.unique(confirmed["track_id"])))
    if truth is not None:
        found["ate_m"] = ovmot.evaluate(run, truth).scalars()["ate_yaw_m"] or 0.0
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    for warning in run.summary["warnings"]:
        print(f"warning: {warning['message']} ({warning['count']})")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
