"""The fixtures that these tests share with those of other folders."""

from drive_fixtures import make_imu_drive
from filter_fixtures import (
    curvy_path,
    landmarks,
    make_rig,
    make_state,
    make_window,
    noise,
    observe,
    rig,
    start_error,
    start_ns,
)

__all__ = [
    "curvy_path",
    "landmarks",
    "make_imu_drive",
    "make_rig",
    "make_state",
    "make_window",
    "noise",
    "observe",
    "rig",
    "start_error",
    "start_ns",
]
