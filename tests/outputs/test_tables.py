import csv
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.outputs.tables import (
    CalibrationTable,
    CovarianceTable,
    PointsTable,
    StateTable,
    StereoTable,
    TimingTable,
    TracksTable,
    TrajectoryTable,
)
from ovmot.types import FrameResult

Maker = Callable[[int], FrameResult]
STAMP = 1_403_636_584_763_555_585


def test_trajectory_text(tmp_path: Path, make_result: Maker) -> None:
    table = TrajectoryTable(tmp_path / "t")
    table.write(make_result(STAMP))
    table.close()
    assert (tmp_path / "t").read_text() == (
        "1403636584.763555585 1.000000000 -2.500000000 0.125000000"
        " 0.000000000 0.000000000 -0.707106781 0.707106781\n"
    )


def test_state_fields_are_under_their_names(tmp_path: Path, make_result: Maker) -> None:
    table = StateTable(tmp_path / "s")
    table.write(make_result(STAMP))
    table.close()
    lines = (tmp_path / "s").read_text().splitlines()
    (row,) = csv.DictReader(lines)
    assert None not in row
    assert None not in row.values()
    assert row["timestamp_ns"] == str(STAMP)
    expected = {
        "x": 1.0, "y": -2.5, "z": 0.125, "qz": -(0.5**0.5), "qw": 0.5**0.5, "vx": 3.0, "vz": -1.0,
        "gyro_bias_x": 0.001, "gyro_bias_z": 0.003, "time_offset_s": -0.0015,
        "imu_cam0_x": 0.1, "imu_cam0_z": 0.3, "imu_cam0_qw": 1.0, "imu_cam1_x": 0.4,
        "imu_cam1_z": 0.6, "imu_cam1_qw": 1.0, "standing": 1.0,
        "std_rotation_x": 0.01, "std_rotation_y": 0.02, "std_rotation_z": 0.03, "std_x": 0.2,
        "std_vz": 0.2, "std_gyro_bias_z": 0.2, "std_time_offset_s": 0.0005,
    }  # fmt: skip
    assert {name: float(row[name]) for name in expected} == pytest.approx(expected, abs=1e-9)
    unknown = {name for name, text in row.items() if text == ""}
    assert unknown == {f"{what}accel_bias_{axis}" for what in ("", "std_") for axis in "xyz"}


def test_state_leaves_a_negative_variance_and_an_unknown_extrinsic_empty(
    tmp_path: Path, make_result: Maker
) -> None:
    result = make_result(0)
    covariance = np.eye(15)
    covariance[3, 3] = -1e-9
    ego = replace(result.ego, covariance=covariance, T_imu_cam1=np.full((4, 4), np.nan))
    table = StateTable(tmp_path / "s")
    table.write(replace(result, ego=ego))
    table.close()
    (row,) = csv.DictReader((tmp_path / "s").read_text().splitlines())
    assert (row["std_x"], row["std_y"]) == ("", "1.000000000")
    assert (row["imu_cam1_x"], row["imu_cam1_qw"], row["imu_cam0_x"]) == ("", "", "0.100000000")


def test_covariance_is_the_upper_triangle_row_by_row(tmp_path: Path, make_result: Maker) -> None:
    result = make_result(STAMP)
    root = np.random.default_rng(1).standard_normal((15, 15)) * 10.0 ** np.arange(-4, 11)[:, None]
    covariance = root @ root.T * 1e-9
    covariance[:, 8] = covariance[8] = np.nan  # an ego source that does not know vz
    table = CovarianceTable(tmp_path / "c")
    table.write(replace(result, ego=replace(result.ego, covariance=covariance)))
    table.close()
    (row,) = csv.DictReader((tmp_path / "c").read_text().splitlines())
    assert row.pop("timestamp_ns") == str(STAMP)
    assert {name for name, text in row.items() if not text} == {
        f"cov_{a}_vz" for a in ("rx", "ry", "rz", "x", "y", "z", "vx", "vy", "vz")
    }
    order = ["rx", "ry", "rz", "x", "y", "z", "vx", "vy", "vz"]
    for name, text in row.items():
        a, b = (order.index(axis) for axis in name.removeprefix("cov_").split("_"))
        if text:
            assert float(text) == pytest.approx(covariance[a, b], rel=1e-9)
    assert list(row)[:10] == [*(f"cov_rx_{b}" for b in order), "cov_ry_ry"]
    assert len(row) == 45


def test_points_text(tmp_path: Path, make_result: Maker) -> None:
    table = PointsTable(tmp_path / "p")
    table.write(make_result(STAMP))
    table.close()
    assert (tmp_path / "p").read_text().splitlines() == [
        "timestamp_ns,feature_id,u,v,u_right,v_right,x_cam,y_cam,z_cam,label,track_id",
        f"{STAMP},7,60.000,60.000,50.062,60.000,1.0000,2.0000,3.5000,dynamic,3",
        f"{STAMP},8,60.000,120.000,55.000,120.000,0.0000,1.0000,9.0000,static,",
        f"{STAMP},9,180.000,60.000,170.000,60.000,-1.0000,0.2500,20.0000,static,",
        f"{STAMP},10,180.123,120.000,,,,,,unknown,",
    ]


def test_stereo_text(tmp_path: Path, make_result: Maker) -> None:
    table = StereoTable(tmp_path / "s")
    table.write(make_result(5))
    table.close()
    assert (tmp_path / "s").read_text() == (
        "timestamp_ns,feature_id,u,v,u_right,v_right,distance_px,accepted\n"
        "5,7,60.000,60.000,100.000,70.000,0.2500,1\n"
        "5,11,200.000,130.000,120.000,120.000,4.5000,0\n"
    )


def test_tracks_text(tmp_path: Path, make_result: Maker) -> None:
    table = TracksTable(tmp_path / "t")
    table.write(make_result(5))
    table.write(replace(make_result(6), tracks=()))
    table.close()
    assert (tmp_path / "t").read_text() == (
        "timestamp_ns,track_id,state,x,y,z,vx,vy,vz,yaw,yaw_rate,length,width,height,"
        "u_min,v_min,u_max,v_max,n_points,std_x,std_y,std_z,std_vx,std_vy,std_vz,"
        "p_walker,p_cyclist,p_vehicle,std_length,std_width,std_height,std_yaw,std_yaw_rate\n"
        "5,3,confirmed,10.0000,1.5000,0.5000,-4.0000,0.2500,0.0000,0.100000,,4.0000,1.7500,1.5000,"
        "50.00,40.00,90.50,80.00,12,0.1000,0.2000,0.3000,0.4000,0.5000,,"
        "0.1250,0.2500,0.6250,,,,,\n"
    )


@pytest.mark.parametrize(
    ("stages", "expected"),
    [
        ((), "timestamp_ns,match,split,other\n1,1.250,2.000,0.000\n2,3.000,,4.500\n"),
        (("split",), "timestamp_ns,split,other\n1,2.000,1.250\n2,,7.500\n"),
    ],
)
def test_timing_columns_stay(
    tmp_path: Path, make_result: Maker, stages: tuple[str, ...], expected: str
) -> None:
    table = TimingTable(tmp_path / "t", stages)
    table.write(make_result(1))
    table.write(replace(make_result(2), milliseconds={"late": 4.5, "match": 3.0}))
    table.close()
    assert (tmp_path / "t").read_text() == expected


def test_estimated_calibration(tmp_path: Path, make_result: Callable[[int], FrameResult]) -> None:
    table = CalibrationTable(tmp_path / "calibration.csv")
    result = make_result(5)
    table.write(result)
    table.write(replace(result, ego=replace(result.ego, calibration=None)))
    table.close()
    assert (tmp_path / "calibration.csv").read_text().splitlines() == [
        "timestamp_ns,cam0_pose_rx,cam0_lens_fx,std_cam0_pose_rx,std_cam0_lens_fx",
        "5,0.01,-2.5,0.001,0.5",
    ]


def test_state_ends_with_segment_and_health(
    tmp_path: Path, make_result: Callable[[int], FrameResult]
) -> None:
    table = StateTable(tmp_path / "state.csv")
    table.write(replace(make_result(5), segment=2))
    table.close()
    header, row = (tmp_path / "state.csv").read_text().splitlines()
    assert header.endswith(",segment,health")
    assert row.endswith(",2,degraded")


@pytest.mark.parametrize("table", [StateTable, TracksTable, PointsTable, StereoTable])
def test_every_column_is_explained_in_the_docs(table: type[StateTable]) -> None:
    docs = Path(__file__).resolve().parents[2] / "docs" / "outputs.md"
    explained = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", docs.read_text()))))
    assert set(table.columns.split(",")) <= explained
