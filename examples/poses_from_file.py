"""Moving objects where the rig's poses are known: from another odometry, or as truth.

    python examples/poses_from_file.py SEQUENCE POSES

POSES is a TUM or EuRoC file of the IMU's poses, or a KITTI file of the left camera's. No IMU is
needed then.
"""

import sys

import numpy as np

import ovmot


def main(folder: str, poses: str) -> dict[int, float]:
    """Print the moving objects of each frame; return the greatest speed of each confirmed one."""
    sequence = ovmot.open(folder)
    initializer = ovmot.poses_from_file(poses, sequence)
    posed = set(initializer.source.pose_ns.tolist())
    odometry = ovmot.Odometry(sequence.rig, initializer=initializer)
    fastest: dict[int, float] = {}
    for event in sequence:
        if isinstance(event, ovmot.StereoFrame) and event.timestamp_ns not in posed:
            continue  # the file has no pose for this frame
        for frame in odometry.add(event):
            for track in frame.tracks:
                if track.state == "confirmed":
                    speed = float(np.linalg.norm(track.velocity))
                    print(f"{frame.timestamp_ns}: object {track.track_id}, {speed:.1f} m/s")
                    fastest[track.track_id] = max(speed, fastest.get(track.track_id, 0.0))
    odometry.finish()
    return fastest


if __name__ == "__main__":
    ovmot.prepare_process()
    main(*sys.argv[1:])
