"""Figures of docs/rig.md: what baseline, shutter and IMU buy, by the formulas on that page.

python docs/figures/rig.py
"""

from pathlib import Path

import numpy as np

from common import BLUE, COLOURS, IMAGES, figure, save
from ovmot.geometry.arrays import FloatArray
from ovmot.physics import PIXEL_SIGMA

RIGS = {
    "EuRoC, 0.11 m, 458 px": (0.11, 458.0),
    "ZED 2 class, 0.12 m, 530 px": (0.12, 530.0),
    "KAIST, 0.475 m, 815 px": (0.475, 815.0),
    "KITTI, 0.54 m, 721 px": (0.54, 721.0),
}
"""Baseline (m) and focal length (pixels)."""

FOCAL_PX, SIDE_M = 700.0, 10.0
"""Of the figure of the shutter: focal length, and distance of what passes sideways."""

IMUS = {
    "consumer chip": (7e-4, 8e-3, 2e-3, 0.05),
    "ADIS16448 (EuRoC)": (1.7e-4, 2e-3, 5e-4, 0.02),
    "tactical": (2e-5, 3e-4, 3e-5, 2e-3),
}
"""Densities of gyroscope (rad/s/√Hz) and accelerometer (m/s²/√Hz); 1-sigma of their biases after
some seconds of images (rad/s, m/s²)."""


def depth_sigma(depth: FloatArray, baseline: float, focal: float) -> FloatArray:
    """σ_z (N,) of one stereo match at depths (N,), m; the baseline in m, the focal length in px."""
    return np.asarray(depth**2 * np.sqrt(2.0) * PIXEL_SIGMA / (focal * baseline))


def drift_sigma(
    seconds: FloatArray, gyro: float, accel: float, gyro_bias: float, accel_bias: float
) -> FloatArray:
    """σ_p (N,) in m after times (N,) without images, from the noise and the biases' 1-sigma."""
    white = accel**2 * seconds**3 / 3.0 + (9.81 * gyro) ** 2 * seconds**5 / 20.0
    biases = (accel_bias * seconds**2 / 2.0) ** 2 + (9.81 * gyro_bias * seconds**3 / 6.0) ** 2
    return np.asarray(np.sqrt(white + biases))


def main(folder: Path = IMAGES) -> list[Path]:
    """Draw the three figures."""
    return [_depth(folder), _shutter(folder), _imu(folder)]


def _depth(folder: Path) -> Path:
    made, axes = figure(6.5, 3.0)
    depth = np.geomspace(1.0, 60.0, 100)
    for (name, (baseline, focal)), colour in zip(RIGS.items(), COLOURS, strict=False):
        style = ":" if name.startswith("KITTI") else "-"  # it lies on KAIST's
        axes.loglog(depth, depth_sigma(depth, baseline, focal), style, color=colour, label=name)
    axes.axhline(1.9, color="k", lw=0.8, ls=":")
    axes.text(1.05, 2.1, "width of a car", fontsize=8)
    axes.set(xlabel="distance (m)", ylabel="depth, 1 sigma (m)", ylim=(1e-3, 50.0))
    axes.legend(fontsize=8)
    return save(made, "rig_depth", folder)


def _shutter(folder: Path) -> Path:
    made, (left, right) = figure(7.0, 2.8, columns=2)
    readout = np.linspace(1.0, 30.0, 50)
    for rate, colour in zip((2.0, 10.0, 30.0, 90.0), COLOURS, strict=False):
        shift = FOCAL_PX * np.deg2rad(rate) * readout * 1e-3
        left.plot(readout, shift, color=colour, label=f"{rate:.0f} °/s")
    for speed, colour in zip((1.0, 5.0, 15.0), COLOURS, strict=False):
        shift = FOCAL_PX * speed / SIDE_M * readout * 1e-3
        right.plot(readout, shift, color=colour, label=f"{speed:.0f} m/s at {SIDE_M:.0f} m")
    for axes, title in ((left, "the rig turns"), (right, "things pass sideways")):
        axes.axhline(PIXEL_SIGMA, color="k", lw=0.8, ls=":")
        axes.set(xlabel="readout of the image (ms)", title=title, yscale="log", ylim=(0.05, 100.0))
        axes.legend(fontsize=8)
    left.text(20.0, PIXEL_SIGMA * 0.55, "matching noise", fontsize=8)
    left.set_ylabel("shift, last row (px)")
    return save(made, "rig_shutter", folder)


def _imu(folder: Path) -> Path:
    made, axes = figure(6.5, 3.0)
    seconds = np.geomspace(0.1, 30.0, 100)
    for (name, values), colour in zip(IMUS.items(), COLOURS, strict=False):
        axes.loglog(seconds, drift_sigma(seconds, *values), color=colour, label=name)
    axes.axvline(0.5, color=BLUE, lw=0.8, ls=":")
    axes.text(0.52, 20.0, "degraded", fontsize=8)
    axes.axvline(5.0, color=BLUE, lw=0.8, ls=":")
    axes.text(5.2, 20.0, "lost", fontsize=8)
    axes.set(xlabel="time without images (s)", ylabel="position, 1 sigma (m)", ylim=(1e-5, 100.0))
    axes.legend(fontsize=8)
    return save(made, "rig_imu", folder)


if __name__ == "__main__":
    main()
