"""The truth of a simulated sequence as it stands in files: objects, depth, the IMU's errors."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ovmot.geometry.arrays import AnyArray, Image
from ovmot.sim.imu_errors import ImuErrors
from ovmot.sim.simulation import Simulation

DEPTH_STEPS_PER_M = 256.0


def depth_image(depth: AnyArray) -> AnyArray:
    """Depth (H, W) in m as uint16, 256 to the metre; 0 for none (not finite or 256 m and more).

    The convention of KITTI's depth maps (J. Uhrig et al., "Sparsity Invariant CNNs", 3DV 2017).
    """
    steps = np.round(DEPTH_STEPS_PER_M * np.where(np.isfinite(depth), depth, 0.0))
    return np.where(steps <= np.iinfo(np.uint16).max, steps, 0.0).astype(np.uint16)


def frame_truth(simulation: Simulation, time_ns: int, object_id: Image) -> dict[str, Any]:
    """One entry of objects.json: box centres, metres, rad, m/s, in the world frame."""
    visible = np.bincount(object_id.ravel(), minlength=256)
    objects = []
    for mover in simulation.scene.movers:
        state = mover.state(time_ns)
        x, y, z = (float(c) for c in state.center)
        length, width, height = (float(c) for c in state.size)
        objects.append(
            {
                "id": state.object_id, "cls": state.category,
                "x": x, "y": y, "z": z, "yaw": state.yaw,
                "l": length, "w": width, "h": height,
                "vx": float(state.velocity[0]), "vy": float(state.velocity[1]),
                "yaw_rate": state.yaw_rate, "visible_px": int(visible[state.object_id]),
            }
        )  # fmt: skip
    T_w_body = simulation.path.pose(time_ns).tolist()
    return {"t_ns": time_ns, "T_w_body": T_w_body, "objects": objects}


def write_imu_errors(path: Path, errors: ImuErrors, time_offset_s: float) -> None:
    """The IMU's true errors, with the names and units of `ImuErrors`; nothing where it has none."""
    if not errors.any and time_offset_s == 0.0:
        return
    values = {
        "time_offset_s": time_offset_s,
        "gyro_matrix": errors.gyro_matrix.tolist(),
        "accel_matrix": errors.accel_matrix.tolist(),
        "g_sensitivity": errors.g_sensitivity.tolist(),
        "gyro_range": errors.gyro_range,
        "accel_range": errors.accel_range,
        "dropped_share": errors.dropped_share,
        "bursts_per_s": errors.bursts_per_s,
        "burst_s": errors.burst_s,
    }
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")
