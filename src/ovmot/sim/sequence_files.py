"""What the writers of all folder formats share: the folder's check, time grids, rows, pictures.

Every written sequence holds, beside what its format asks for, the truth in `truth/`:

- `<ns>.png`: the object id at every left pixel, 0 where no mover is seen;
- `depth/<ns>.png`: the left view's depth as 16-bit integers, 256 to the metre (the convention of
  KITTI's depth maps); 0 in the sky, beyond 255.99 m and where the lens has no ray;
- `poses.csv`: ns and the IMU's pose, where the format itself has no place for it;
- `imu.csv`: ns and the true gyro and accel bias of every IMU sample;
- `imu_errors.yaml`: the IMU's systematic errors and time offset, where it has any;
- `objects.json`: the rig's pose and all movers at every frame. It is written last and in one piece:
  a folder without it was interrupted.
"""

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray
from ovmot.sim.imu import SimulatedImu, simulated_imu
from ovmot.sim.render import RenderedFrame, render_stereo
from ovmot.sim.simulation import Simulation
from ovmot.sim.truth import depth_image, frame_truth, write_imu_errors

SavePictures = Callable[[RenderedFrame], None]
"""Writes the pictures of a frame where a format has them; called in threads."""

_IMU_LEAD_S, _IMU_TAIL_S = 0.5, 0.3
_WRITERS, _FRAMES_IN_FLIGHT = 2, 4
_PNG_FAST = (
    cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
)  # fmt: skip


def make_folders(folder: Path, names: tuple[str, ...]) -> None:
    """Make an empty folder's parts and those of the truth; `InputError` where it is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError.at(folder, "exists and is not an empty folder", "choose another")
    for name in (*names, "truth/depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)


def generators(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Generators of the pictures' noise and of the IMU's, independent of each other."""
    pictures, imu = np.random.SeedSequence(seed).spawn(2)
    return np.random.default_rng(pictures), np.random.default_rng(imu)


def imu_times(simulation: Simulation) -> IntArray:
    """IMU stamps (N,) in ns by the IMU's clock, from before the first image to after the last.

    Without a time offset one of them is the first image's.
    """
    first, last = int(simulation.camera_ns[0]), int(simulation.camera_ns[-1])
    period_ns = round(1e9 / simulation.imu.rate_hz)
    first += period_ns * round(1e9 * simulation.rig.time_offset_s / period_ns)
    last += round(1e9 * simulation.rig.time_offset_s)
    before = int(_IMU_LEAD_S * simulation.imu.rate_hz)
    count = before + (last - first) // period_ns + int(_IMU_TAIL_S * simulation.imu.rate_hz) + 1
    return first + period_ns * (np.arange(count, dtype=np.int64) - before)


def truth_times(simulation: Simulation) -> IntArray:
    """Stamps (N,) of the true poses, by the cameras' clock: every frame's, and the IMU's rate."""
    first, last = simulation.camera_ns[0], simulation.camera_ns[-1]
    period_ns = round(1e9 / simulation.imu.rate_hz)
    regular = np.arange(first, last + 1, period_ns, dtype=np.int64)
    return np.union1d(regular, simulation.camera_ns)


def imu_samples(simulation: Simulation, rng: np.random.Generator) -> SimulatedImu:
    """The samples that the sequence's IMU file holds."""
    return simulated_imu(
        simulation.path, imu_times(simulation), simulation.imu, rng,
        time_offset_s=simulation.rig.time_offset_s,
    )  # fmt: skip


def write_true_poses(folder: Path, simulation: Simulation) -> None:
    """truth/poses.csv: ns, IMU position, quaternion w x y z."""
    times = truth_times(simulation)
    T_world_imu = simulation.path.pose(times)
    wxyz = so3.to_quaternion(T_world_imu[:, :3, :3])[:, [3, 0, 1, 2]]
    poses = np.concatenate([T_world_imu[:, :3, 3], wxyz], axis=1)
    write_rows(folder / "truth/poses.csv", times, poses)


def write_rows(
    path: Path, times: IntArray, values: FloatArray, header: str = "", separator: str = ","
) -> None:
    """A line per row: the stamp as an integer, then the values with nine decimals."""
    with path.open("w", encoding="utf-8") as file:
        if header:
            file.write(f"{header}\n")
        for time_ns, row in zip(times.tolist(), values.tolist(), strict=True):
            fields = (str(time_ns), *(f"{x:.9f}" for x in row))
            file.write(separator.join(fields) + "\n")


def write_imu_truth(folder: Path, simulation: Simulation, imu: SimulatedImu) -> None:
    """truth/imu.csv and, where there are errors, truth/imu_errors.yaml."""
    header = "#timestamp_ns," + ",".join(f"{s}_bias_{c}" for s in ("gyro", "accel") for c in "xyz")
    biases = np.concatenate([imu.gyro_bias, imu.accel_bias], axis=1)
    write_rows(folder / "truth/imu.csv", imu.data.timestamp_ns, biases, header)
    errors, offset_s = simulation.imu.errors, simulation.rig.time_offset_s
    write_imu_errors(folder / "truth/imu_errors.yaml", errors, offset_s)


def by_stamp(left: Path, right: Path) -> SavePictures:
    """Pictures named `<ns>.png` in a folder of each camera."""

    def save(frame: RenderedFrame) -> None:
        name = f"{frame.frame.timestamp_ns}.png"
        write_png(left / name, frame.frame.left)
        write_png(right / name, frame.frame.right)

    return save


def write_frames(
    folder: Path, simulation: Simulation, save: SavePictures, rng: np.random.Generator
) -> Iterator[int]:
    """Render the frames and have their pictures saved; their truth goes into `folder`.

    Yields each frame's time in ns when all its pictures are on disk; pictures are encoded in
    threads of their own. Raises `OSError` where they can not be written.
    """
    frames = render_stereo(
        simulation.scene, simulation.rig, simulation.path, simulation.camera_ns,
        simulation.optics, rng,
    )  # fmt: skip
    entries = []
    pending: deque[tuple[int, Future[None]]] = deque()
    with ThreadPoolExecutor(max_workers=_WRITERS) as pool:
        for frame in frames:
            time_ns = frame.frame.timestamp_ns
            pending.append((time_ns, pool.submit(_write_frame, folder, save, frame)))
            entries.append(frame_truth(simulation, time_ns, frame.left.object_id))
            if len(pending) >= _FRAMES_IN_FLIGHT:
                yield _finished(*pending.popleft())
        while pending:
            yield _finished(*pending.popleft())
    partial = folder / "truth/objects.json.partial"
    partial.write_text(json.dumps(entries), encoding="utf-8")
    partial.replace(folder / "truth/objects.json")


def _finished(time_ns: int, job: Future[None]) -> int:
    job.result()
    return time_ns


def _write_frame(folder: Path, save: SavePictures, frame: RenderedFrame) -> None:
    name = f"{frame.frame.timestamp_ns}.png"
    save(frame)
    write_png(folder / "truth" / name, frame.left.object_id)
    write_png(folder / "truth/depth" / name, depth_image(frame.left.depth))


def write_png(path: Path, image: AnyArray) -> None:
    """Encoded in memory, so that a full disk is an error and not a short file."""
    _, data = cv2.imencode(".png", image, _PNG_FAST)
    path.write_bytes(data.tobytes())
