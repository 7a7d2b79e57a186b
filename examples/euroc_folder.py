"""Odometry on a EuRoC folder, or on any other data set that ovmot knows.

python examples/euroc_folder.py MH_01_easy
"""

import sys

import numpy as np

import ovmot


def main(folder: str) -> float:
    """Print each frame's position with its 1-sigma and the moving objects; return the path in m."""
    sequence = ovmot.open(folder)
    settings = ovmot.load_settings(overrides=["tracker.max_features=200"])
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise, settings)
    positions = []
    for event in sequence:
        for frame in odometry.add(event):
            positions.append(frame.T_world_imu[:3, 3])
            sigma = np.sqrt(np.diag(frame.covariance)[3:6])
            print(f"{frame.timestamp_ns}: {positions[-1].round(3)} m, sigma {sigma.round(3)} m")
            for track in frame.tracks:
                speed = np.linalg.norm(track.velocity)
                print(f"  object {track.track_id}, {track.state}: {speed:.1f} m/s")
    odometry.finish()
    if not positions:
        raise SystemExit(f"{folder}: no initial state: {odometry.not_started_because}")
    length = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
    print(f"{len(positions)} of {len(sequence)} frames, {length:.1f} m")
    return length


if __name__ == "__main__":
    ovmot.prepare_process()
    main(sys.argv[1])
