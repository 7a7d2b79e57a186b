"""A finished run as one value: its files read back, as NumPy arrays or pandas DataFrames."""

import json
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ovmot.datasets.pose_files import Trajectory
from ovmot.errors import InputError
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_json import RUN_JSON
from ovmot.outputs.run_reader import REMEDY, EgoRun, read_ego_run, read_table
from ovmot.settings import Settings
from ovmot.settings_file import make_settings
from ovmot.text_files import StrPath, read_text

if TYPE_CHECKING:
    from pandas import DataFrame

Rows = NDArray[np.void]
"""A structured array: a row of it is a row of the file, `rows["name"]` one of its columns."""

WHOLE = ("track_id", "feature_id", "n_points", "standing", "segment", "accepted")
"""Columns of whole numbers beside `timestamp_ns`; -1 where the field is empty."""
TEXTS = ("state", "label", "health")
"""Columns of text."""
_WHEN = {
    "points": "run it again with --save-points",
    "stereo": "run it again with --save-points",
    "calibration": "run it again with a setting of calibration.* switched on",
}


class Run:
    """The folder of a finished run; each file is read when it is first asked for.

    docs/outputs.md has the columns. Tables are structured arrays with the names of these columns:
    `run.tracks["vx"]` is a column (M,), `run.tracks[run.tracks["track_id"] == 3]` the rows of one
    object. Stamps and ids are integers, `state`, `label` and `health` texts, the rest floats; an
    empty field is NaN, or -1 in a column of integers.

    Parameters
    ----------
    folder
        The output folder of `ovmot run`, `ovmot.run_sequence`, or of a node's recording.

    Raises
    ------
    InputError
        Here for a folder that is no run; by a property for a file that is missing or broken.
    """

    def __init__(self, folder: StrPath) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            problem = "is not a folder" if self.folder.exists() else "no such folder"
            raise InputError.at(self.folder, problem, "give the output folder of a run")
        if not (self.folder / "trajectory.tum").is_file():
            problem = "is not a run: it holds no trajectory.tum"
            raise InputError.at(self.folder, problem, "give the output folder of a run")

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    @property
    def trajectory(self) -> Trajectory:
        """`timestamp_ns` (N,) and `T_world_imu` (N, 4, 4): poses of the IMU in the world, m."""
        return Trajectory(self._ego.timestamp_ns, self._ego.T_world_imu)

    @property
    def covariance(self) -> FloatArray:
        """The (N, 9, 9) covariance of rotation, position and velocity at the trajectory's stamps.

        Rotation is about the IMU's axes (right perturbation, rad), position (m) and velocity (m/s)
        are in the world. Rows that the file lacks are NaN.
        """
        found = self._ego.covariance
        if found is None:
            raise InputError.at(self.folder / "covariance.csv", "no such file", REMEDY)
        return found

    @cached_property
    def state(self) -> Rows:
        """`state.csv`, a row for each frame: pose, velocity, biases, calibration, 1-sigma."""
        return self._table("state")

    @cached_property
    def tracks(self) -> Rows:
        """`tracks.csv`, a row for each moving object and frame, in the world; SI units."""
        return self._table("tracks")

    @cached_property
    def points(self) -> Rows:
        """`points.csv`, a row for each feature and frame: pixels, left camera's axes, label."""
        return self._table("points")

    @cached_property
    def stereo(self) -> Rows:
        """`stereo.csv`, a row for each stereo match tested, in pixels."""
        return self._table("stereo")

    @cached_property
    def calibration(self) -> Rows:
        """`calibration.csv`: how far each estimated number is from the file's, and its 1-sigma."""
        return self._table("calibration")

    @cached_property
    def timing(self) -> Rows:
        """`timing.csv`: milliseconds of each stage, each frame."""
        return self._table("timing")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`run.json`: how the run ended, its input, counts, warnings, options and versions."""
        path = self.folder / RUN_JSON
        try:
            found = json.loads(read_text(path, InputError))
        except ValueError as error:
            raise InputError.at(path, f"is no JSON: {error}", REMEDY) from None
        if not isinstance(found, dict):
            raise InputError.at(path, "holds no keys", REMEDY)
        return found

    @property
    def settings(self) -> Settings:
        """The settings that the run used."""
        return make_settings(self.summary["settings"], (), str(self.folder / RUN_JSON))

    @property
    def looked_for_objects(self) -> bool:
        """False for a run with one camera or `--no-objects`; True where `run.json` is missing."""
        if not (self.folder / RUN_JSON).is_file():
            return True
        used = self.summary.get("settings", {})
        return bool(used.get("objects", {}).get("enabled", True))

    def to_pandas(self, table: str) -> "DataFrame":
        """A table as a DataFrame with the same columns: "state", "tracks", "points", ...

        Raises `InputError` where pandas is not installed, or there is no such table.
        """
        try:
            from pandas import DataFrame
        except ImportError:
            raise InputError("DataFrames need pandas: pip install 'ovmot[pandas]'") from None
        return DataFrame(self._table(table))

    @cached_property
    def _ego(self) -> EgoRun:
        return read_ego_run(self.folder)

    def _table(self, name: str) -> Rows:
        path = self.folder / f"{name}.csv"
        if not path.is_file():
            raise InputError.at(path, "no such file", _WHEN.get(name, REMEDY))
        return read_rows(path)


def read_rows(path: Path) -> Rows:
    """The rows (M,) of a table of a run, by the names of its columns; raises `InputError`."""
    names = _column_names(path)
    if not names:  # nothing was written, not even the header
        return np.empty(0, dtype=np.dtype([]))
    texts = tuple(name for name in names if name in TEXTS)
    numbers = tuple(name for name in names if name not in ("timestamp_ns", *texts))
    table = read_table(path, numbers, texts)
    columns: dict[str, NDArray[Any]] = {"timestamp_ns": table.timestamp_ns}
    columns |= {name: np.array(table.texts[name], dtype=np.str_) for name in texts}
    for name, values in zip(numbers, table.values.T, strict=True):
        known = np.where(np.isnan(values), -1.0, values) if name in WHOLE else values
        columns[name] = known.astype(np.int64) if name in WHOLE else known
    rows = np.empty(len(table.timestamp_ns), [(name, columns[name].dtype) for name in names])
    for name in names:
        rows[name] = columns[name]
    return rows


def _column_names(path: Path) -> list[str]:
    line = read_text(path, InputError).partition("\n")[0]
    return line.split(",") if line else []
