"""The truth of a sequence: the rig's motion, boxes of objects, images of ids and depth.

Where the true poses are depends on the data set: `TRUTH_FILES`, else the `truth.py` of a format's
folder (`find_truth.py`). Sequences that ovmot writes hold,
in `truth/`:

- `<ns>.png`: the object id at every left pixel, 0 where no object is seen;
- `depth/<ns>.png`: the left view's depth as 16-bit integers, 256 to the metre (the convention of
  KITTI's depth maps); 0 in the sky, beyond 255.99 m and where the camera model has no ray;
- `poses.csv`: ns and the IMU's pose, where the format itself has no place for it;
- `imu.csv`: ns and the true gyro and accel bias of every IMU sample;
- `imu_errors.yaml`: the IMU's systematic errors and time offset, where it has any;
- `objects.json`: the rig's pose and all objects at every frame. It is written last and in one
  piece.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from ovmot.cameras.camera import Camera
from ovmot.datasets.pose_files import read_euroc_ground_truth, read_tum
from ovmot.datasets.text_tables import column_count, read_stamped_csv
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, Image, IntArray
from ovmot.text_files import read_text

_EUROC = "state_groundtruth_estimate0"
_EUROC_SIGMA_M = 1e-3
"""Of EuRoC's true positions: those of its laser tracker and its motion capture are good to a
millimetre (M. Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016)."""
_SIMULATED = "truth"
TRUTH_FILES = (
    f"mav0/{_EUROC}/data.csv",
    f"mav0/{_EUROC}/trajectory.tum",
    "truth/poses.csv",
    f"{_EUROC}/data.csv",
    f"{_EUROC}/trajectory.tum",
    "mav0/mocap0/data.csv",
    "mocap0/data.csv",
    "dso/gt_imu.csv",
)
"""Where in a data set's folder the IMU's true poses may be, in EuRoC's or TUM's form; the first one
that is there is taken.

EuRoC's comes first, because it may hold velocity and biases too; `mocap0` and `gt_imu.csv` are
TUM-VI's."""


@dataclass(frozen=True, slots=True)
class EgoTruth:
    """True poses `T_world_imu` (N, 4, 4) at rising stamps (N,), in a world with z up.

    `velocity` (N, 3) in m/s in the world, `gyro_bias` (N, 3) in rad/s and `accel_bias` (N, 3) in
    m/s², where the file has them. `path` is that file. `position_sigma_m` (N,): standard deviation
    of each coordinate of the position, as the data set states it; None where it states none.
    """

    path: Path
    timestamp_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray | None = None
    gyro_bias: FloatArray | None = None
    accel_bias: FloatArray | None = None
    position_sigma_m: FloatArray | None = None


def read_ego_truth(data: Path) -> EgoTruth:
    """The truth of a data set's folder, or of a file itself: TUM, or `.csv` as EuRoC writes it.

    Raises `InputError` where there is none, or a row of it cannot be used.
    """
    path = data if data.is_file() else _find(data)
    if path.suffix != ".csv":
        trajectory = read_tum(path)
        stamps, T = trajectory.timestamp_ns, trajectory.T_world_imu
        return EgoTruth(path, stamps, T, position_sigma_m=_stated_sigma(path, len(stamps)))
    n_columns = column_count(path, ",")
    if n_columns == 0:
        raise InputError.at(path, "holds no data", "give a file with true poses")
    trajectory = read_euroc_ground_truth(path)
    stamps, T = trajectory.timestamp_ns, trajectory.T_world_imu
    sigma = _stated_sigma(path, len(stamps))
    if n_columns != 17:
        return EgoTruth(path, stamps, T, position_sigma_m=sigma)
    table = read_stamped_csv(path, 17)
    _, fresh = np.unique(table.timestamp_ns, return_index=True)  # equal stamps keep the first
    rest = table.values[fresh, 7:]
    return EgoTruth(path, stamps, T, rest[:, :3], rest[:, 3:6], rest[:, 6:], sigma)


def _stated_sigma(path: Path, n: int) -> FloatArray | None:
    """Sigmas (n,) of the positions of a file: EuRoC's, or zero where ovmot has simulated it."""
    place = path.resolve().parent
    data = place.parent.parent if place.parent.name == "mav0" else place.parent
    if place.name == _SIMULATED or (place.name == _EUROC and (data / _SIMULATED).is_dir()):
        return np.zeros(n)
    return np.full(n, _EUROC_SIGMA_M) if place.name == _EUROC else None


def truth_file(data: Path) -> Path | None:
    """The first of `TRUTH_FILES` that a folder holds."""
    return next((data / name for name in TRUTH_FILES if (data / name).is_file()), None)


def _find(data: Path) -> Path:
    if not data.exists():
        raise InputError.at(data, "no such file or folder", "give the truth by --truth")
    found = truth_file(data)
    if found is None:
        known = ", ".join(TRUTH_FILES[:3])
        raise InputError.at(data, f"holds no true poses (looked for {known})", "give a TUM file")
    return found


DEPTH_STEPS_PER_M = 256.0
"""Of depth images, as KITTI's: 16 bits, 0 where nothing is known."""
_NUMBERS = ("x", "y", "z", "yaw", "l", "w", "h", "vx", "vy", "yaw_rate", "visible_px")
_REMEDY = "simulate the sequence again"


@dataclass(frozen=True, slots=True)
class TrueObjects:
    """The N objects of one frame, in the true world.

    `center` (N, 3) of the box, `yaw` (N,), `size` (N, 3) length, width, height, `velocity` (N, 3),
    `yaw_rate` (N,), `visible_px` (N,) pixels of it in the left image; `category` names the kind of
    each, and is empty where it is not read. `evaluated` (N,): which the data's own rules count, all
    where it is None. Metres, radians, seconds.
    """

    timestamp_ns: int
    object_id: IntArray
    center: FloatArray
    yaw: FloatArray
    size: FloatArray
    velocity: FloatArray
    yaw_rate: FloatArray
    visible_px: IntArray
    category: tuple[str, ...] = ()
    evaluated: BoolArray | None = None


@dataclass(frozen=True, slots=True)
class ImageRules:
    """What a benchmark leaves out by the left image: regions nobody looked at, and small tracks.

    `regions` by stamp: boxes (R, 4), left, top, right, bottom in pixels. `min_height_px`: tracks
    that are not higher are neither hits nor false. `T_cam0_imu` (4, 4).
    """

    camera: Camera
    T_cam0_imu: FloatArray
    min_height_px: float
    regions: dict[int, FloatArray]

    def leave_out(self, timestamp_ns: int, center: FloatArray, height_m: FloatArray) -> BoolArray:
        """Which tracks (P,) are left out where they are on no object; `center` (P, 3) in the IMU's
        frame, `height_m` (P,)."""
        p = se3.apply(self.T_cam0_imu, center)
        pixel = self.camera.project(p)[:, None, :]  # NaN behind the camera, and nowhere inside
        small = self.camera.intrinsics[1] * height_m <= self.min_height_px * p[:, 2]
        boxes = self.regions.get(timestamp_ns, np.empty((0, 4)))
        inside = (pixel >= boxes[None, :, :2]) & (pixel <= boxes[None, :, 2:])
        in_region = np.any(np.all(inside, axis=2), axis=1)
        return np.asarray((small & (p[:, 2] > 0.0)) | in_region)


@dataclass(frozen=True, slots=True)
class ObjectTruth:
    """All frames by their stamp, and the folder with their images, where there are any."""

    folder: Path
    frames: dict[int, TrueObjects]
    has_ids: bool = True
    image_rules: ImageRules | None = None

    def read_ids(self, timestamp_ns: int) -> Image:
        """The object's id at every left pixel (H, W), 0 where no mover is; raises `InputError`."""
        path = self.folder / f"{timestamp_ns}.png"
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise InputError.at(path, "is not there or not an image", _REMEDY)
        return np.asarray(image, dtype=np.uint8)

    @property
    def has_depth(self) -> bool:
        """Whether there are depth images."""
        return (self.folder / "depth").is_dir()

    def read_depth(self, timestamp_ns: int) -> FloatArray:
        """Depth (H, W) along the left camera's z axis in m, NaN where none; raises `InputError`."""
        path = self.folder / "depth" / f"{timestamp_ns}.png"
        image: AnyArray | None = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16:
            raise InputError.at(path, "is not there or not a 16-bit image", _REMEDY)
        return np.where(image > 0, image / DEPTH_STEPS_PER_M, np.nan)


def read_object_truth(data: Path) -> ObjectTruth | None:
    """The objects of a sequence's folder, None where it has no `truth/objects.json`.

    Raises `InputError` for a file that is not what a simulation writes.
    """
    path = data / "truth" / "objects.json"
    if not path.is_file():
        return None
    try:
        listed = json.loads(read_text(path, InputError))
    except (ValueError, RecursionError) as error:
        raise InputError.at(path, f"cannot be read: {error}", _REMEDY) from None
    if not isinstance(listed, list):
        raise InputError.at(path, "is not a list of frames", _REMEDY)
    frames = [_frame(path, i, entry) for i, entry in enumerate(listed)]
    return ObjectTruth(path.parent, {frame.timestamp_ns: frame for frame in frames})


def _frame(path: Path, index: int, entry: Any) -> TrueObjects:
    try:
        objects = entry["objects"]
        numbers = np.array(
            [[float(o[key]) for key in _NUMBERS] for o in objects], dtype=np.float64
        ).reshape(-1, len(_NUMBERS))
        ids = np.array([int(o["id"]) for o in objects], dtype=np.int64)
        stamp = int(entry["t_ns"])
    except (KeyError, TypeError, ValueError) as error:
        what = f"frame {index} lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputError.at(path, what, _REMEDY) from None
    if not np.all(np.isfinite(numbers)) or len(np.unique(ids)) != len(ids):
        raise InputError.at(
            path, f"frame {index} holds numbers that are not finite, or an id twice", _REMEDY
        )
    velocity = np.concatenate([numbers[:, 7:9], np.zeros((len(ids), 1))], axis=1)
    return TrueObjects(
        stamp, ids, numbers[:, :3], numbers[:, 3], numbers[:, 4:7], velocity, numbers[:, 9],
        numbers[:, 10].astype(np.int64),
    )  # fmt: skip


def depth_image(depth: AnyArray) -> AnyArray:
    """Depth (H, W) in m as uint16, 256 to the metre; 0 for none (not finite or 256 m and more).

    The convention of KITTI's depth maps (J. Uhrig et al., "Sparsity Invariant CNNs", 3DV 2017).
    """
    steps = np.round(DEPTH_STEPS_PER_M * np.where(np.isfinite(depth), depth, 0.0))
    return np.where(steps <= np.iinfo(np.uint16).max, steps, 0.0).astype(np.uint16)


def object_entry(objects: TrueObjects, T_world_imu: FloatArray) -> dict[str, Any]:
    """One frame of objects.json: box centres, metres, rad, m/s, in the world frame."""
    rows = zip(
        objects.object_id.tolist(), objects.category, objects.center.tolist(), objects.yaw.tolist(),
        objects.size.tolist(), objects.velocity.tolist(), objects.yaw_rate.tolist(),
        objects.visible_px.tolist(), strict=True,
    )  # fmt: skip
    return {
        "t_ns": objects.timestamp_ns,
        "T_w_body": T_world_imu.tolist(),
        "objects": [
            {
                "id": number, "cls": category,
                "x": x, "y": y, "z": z, "yaw": yaw,
                "l": length, "w": width, "h": height,
                "vx": velocity[0], "vy": velocity[1],
                "yaw_rate": yaw_rate, "visible_px": visible,
            }
            for number, category, (x, y, z), yaw, (length, width, height), velocity, yaw_rate,
            visible in rows
        ],
    }  # fmt: skip


def write_object_truth(path: Path, entries: list[dict[str, Any]]) -> None:
    """Write objects.json in one step; raises `OSError`."""
    partial = path.with_name(f"{path.name}.partial")
    partial.write_text(json.dumps(entries), encoding="utf-8")
    partial.replace(path)


def write_imu_errors(path: Path, errors: dict[str, Any]) -> None:
    """The IMU's true errors by name, in SI units, as YAML; raises `OSError`."""
    text = yaml.safe_dump(errors, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")
