"""Odometry on a rig of your own: calibration as arrays, images and IMU from files of your own.

    python examples/own_rig.py LEFT RIGHT IMU

LEFT and RIGHT are folders of grey images named by their stamps, `<ns>.png`; IMU is a csv file with
rows of ns, gyro x y z in rad/s, accel x y z in m/s².
"""

import sys
from collections.abc import Iterator
from heapq import merge
from pathlib import Path

import cv2
import numpy as np

import ovmot


def my_rig() -> ovmot.StereoRig:
    """Two equal cameras, 0.5 m apart, that look along x of an IMU with y left and z up."""
    K = [[230.0, 0.0, 159.5], [0.0, 230.0, 99.5], [0.0, 0.0, 1.0]]
    camera = ovmot.Camera.from_matrix(K, (320, 200), "radtan", [-0.05, 0.01, 0.0, 0.0])
    # a camera has x right, y down, z ahead; T_imu_cam maps its points into the IMU's frame
    T_imu_cam0, T_imu_cam1 = np.eye(4), np.eye(4)
    T_imu_cam0[:3, :3] = T_imu_cam1[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T_imu_cam0[:3, 3], T_imu_cam1[:3, 3] = [0.1, 0.25, 0.0], [0.1, -0.25, 0.0]
    return ovmot.StereoRig.make(camera, camera, T_imu_cam0, T_imu_cam1)


MY_IMU = ovmot.ImuNoise(gyro=1.7e-4, gyro_walk=2e-5, accel=2e-3, accel_walk=3e-4)


def imu_samples(file: Path) -> Iterator[ovmot.Event]:
    """The rows of the csv file; stamps stay integers, since a float has too few digits."""
    row = np.dtype([("ns", np.int64), ("gyro", np.float64, 3), ("accel", np.float64, 3)])
    for ns, gyro, accel in np.loadtxt(file, dtype=row, delimiter=",", comments="#"):
        yield ovmot.ImuSample(int(ns), gyro, accel)


def stereo_frames(left: Path, right: Path) -> Iterator[ovmot.Event]:
    """The pairs of images, read one by one."""
    for name in sorted(path.name for path in left.glob("*.png")):
        images = [cv2.imread(str(side / name), cv2.IMREAD_GRAYSCALE) for side in (left, right)]
        a, b = (np.asarray(image, dtype=np.uint8) for image in images)
        yield ovmot.StereoFrame(int(name.removesuffix(".png")), a, b)


def main(left: Path, right: Path, imu: Path) -> list[ovmot.FrameResult]:
    """Print the rig's position at every frame."""
    odometry = ovmot.Odometry(my_rig(), MY_IMU)
    results: list[ovmot.FrameResult] = []
    for event in merge(
        imu_samples(imu), stereo_frames(left, right), key=lambda event: event.timestamp_ns
    ):
        for frame in odometry.add(event):
            print(frame.timestamp_ns, *np.round(frame.T_world_imu[:3, 3], 3))
            results.append(frame)
    return results + odometry.finish()


if __name__ == "__main__":
    ovmot.prepare_process()
    main(*map(Path, sys.argv[1:]))
