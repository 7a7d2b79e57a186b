from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.pose_files import write_tum
from ovmot.datasets.truth import read_object_truth
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import read_ego_run, read_matches, read_points, read_tracks
from ovmot.outputs.tables import CovarianceTable, StateTable, TrajectoryTable
from ovmot.types import EgoEstimate, FrameResult, ScenePoints, StereoFrame, StereoMatches

START = 1_403_636_584_763_555_585
NAN = float("nan")


def result(index: int) -> FrameResult:
    """A frame whose state says its index everywhere, with a covariance without symmetry in axes."""
    root = np.random.default_rng(index).standard_normal((15, 15))
    ego = EgoEstimate(
        timestamp_ns=START + 100 * index,
        T_world_imu=se3.make(so3.exp(np.array([0.0, 0.0, index])), np.array([index, 2.0, 3.0])),
        velocity=np.array([index, 0.5, 0.25]),
        gyro_bias=np.array([0.001, 0.002, index]),
        accel_bias=np.array([0.1, NAN, 0.3]),
        covariance=root @ root.T,
        T_imu_cam0=np.eye(4),
        T_imu_cam1=np.eye(4),
        time_offset_s=0.0,
        time_offset_std_s=NAN,
        standing=False,
    )
    nothing, grey = np.empty(0), np.zeros((2, 2), dtype=np.uint8)
    ids, none = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.bool_)
    points = ScenePoints(
        ids, nothing, nothing, nothing, ids, ids, nothing, nothing, nothing, nothing, none
    )
    matches = StereoMatches(ids, nothing, nothing, none, nothing)
    return FrameResult(StereoFrame(ego.timestamp_ns, grey, grey), ego, points, matches, (), {})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run of three frames, written by the run's own tables."""
    tables = (
        TrajectoryTable(tmp_path / "trajectory.tum"),
        StateTable(tmp_path / "state.csv"),
        CovarianceTable(tmp_path / "covariance.csv"),
    )
    for table in tables:
        for index in range(3):
            table.write(result(index))
        table.close()
    return tmp_path


@pytest.mark.parametrize("file", ["trajectory.tum", "state.csv", "covariance.csv"])
def test_a_row_torn_by_a_kill_is_passed_over(run: Path, file: str) -> None:
    text = (run / file).read_text()
    (run / file).write_text(text[:-7])
    got = read_ego_run(run)
    assert len(got.timestamp_ns) == (2 if file == "trajectory.tum" else 3)
    assert np.isfinite(known(got.velocity)[:2]).all()
    assert np.isnan(known(got.velocity)[2:]).all() == (file != "covariance.csv")
    assert np.isfinite(known(got.covariance)[:2]).all()


def known(array: FloatArray | None) -> FloatArray:
    assert array is not None
    return array


def test_what_a_run_wrote_is_read_back(run: Path) -> None:
    got = read_ego_run(run)
    expected = [result(index).ego for index in range(3)]
    assert got.timestamp_ns.tolist() == [ego.timestamp_ns for ego in expected]

    def column(take: Callable[[EgoEstimate], FloatArray]) -> FloatArray:
        return np.stack([take(ego) for ego in expected])

    np.testing.assert_allclose(got.T_world_imu, column(lambda e: e.T_world_imu), atol=1e-8)
    np.testing.assert_allclose(known(got.velocity), column(lambda e: e.velocity), atol=1e-9)
    np.testing.assert_allclose(known(got.gyro_bias), column(lambda e: e.gyro_bias), atol=1e-9)
    np.testing.assert_allclose(known(got.accel_bias), column(lambda e: e.accel_bias), atol=1e-9)
    deviations = column(lambda e: np.sqrt(np.diag(e.covariance)))
    np.testing.assert_allclose(known(got.sigma), deviations, atol=1e-9)
    blocks = column(lambda e: e.covariance[:9, :9])
    np.testing.assert_allclose(known(got.covariance), blocks, rtol=1e-9)


def test_a_run_of_poses_alone(tmp_path: Path) -> None:
    write_tum(tmp_path / "trajectory.tum", np.array([1, 2]), np.stack([np.eye(4)] * 2))
    got = read_ego_run(tmp_path)
    assert len(got.timestamp_ns) == 2
    assert all(
        part is None
        for part in (got.velocity, got.gyro_bias, got.accel_bias, got.sigma, got.covariance)
    )


def test_a_stopped_run_lacks_its_last_rows(run: Path) -> None:
    path = run / "covariance.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    covariance = known(read_ego_run(run).covariance)
    assert np.isfinite(covariance[:2]).all()
    assert np.isnan(covariance[2]).all()


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("trajectory.tum", lambda _: "", "holds no data"),
        ("trajectory.tum", lambda text: text.replace("2.0", "two", 1), "row 1: .* not a number"),
        ("state.csv", lambda _: "", "is empty"),
        ("state.csv", lambda text: text.replace(",vx,", ",wx,"), "row 1: has no column 'vx'"),
        ("state.csv", lambda text: text[: len(text) // 2] + "\n", "columns where 51 are expected"),
        ("covariance.csv", lambda text: text.replace("e+0", "q", 1), "row 2: is not a number"),
        ("covariance.csv", lambda text: text.replace(f"{START}"[:9], "9"), "no row for any stamp"),
        ("covariance.csv", lambda text: text.splitlines()[0] + "\n", "no row for any stamp"),
    ],
)
def test_broken_files_are_named_in_one_line(
    run: Path, file: str, change: Callable[[str], str], message: str
) -> None:
    path = run / file
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message) as caught:
        read_ego_run(run)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text(run: Path) -> None:
    (run / "state.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"state.csv: cannot be read as a table"):
        read_ego_run(run)


def test_folders_that_are_no_run(tmp_path: Path) -> None:
    for path, problem in (
        (tmp_path, "is not a run: it holds no trajectory.tum"),
        (tmp_path / "nowhere", "no such folder"),
        (Path(__file__), "is not a folder"),
    ):
        with pytest.raises(InputError, match=problem):
            read_ego_run(path)


def test_a_covariance_that_is_not_known_is_nan(run: Path) -> None:
    (run / "covariance.csv").unlink()
    table = CovarianceTable(run / "covariance.csv")
    for index in range(3):
        frame = result(index)
        unknown = np.full((15, 15), np.nan)
        unknown[:6, :6] = np.eye(6)
        table.write(replace(frame, ego=replace(frame.ego, covariance=unknown)))
    table.close()
    covariance = known(read_ego_run(run).covariance)
    np.testing.assert_array_equal(covariance[:, :6, :6], [np.eye(6)] * 3)
    assert np.isnan(covariance[:, 6:, :]).all()


TRACK_COLUMNS = (
    "timestamp_ns,track_id,state,x,y,z,vx,vy,vz,yaw,yaw_rate,length,width,height,"
    "u_min,v_min,u_max,v_max,n_points,std_x,std_y,std_z,std_vx,std_vy,std_vz"
)


ROW = "5,{id},{state},1,2,3,4,5,6,0.1,0.2,4,2,1.5,0,0,9,9,8,0.1,0.1,0.1,0.2,0.2,0.2"


def write(path: Path, *lines: str) -> Path:
    path.write_text("".join(f"{line}\n" for line in lines))
    return path.parent


def test_only_confirmed_tracks_count(tmp_path: Path) -> None:
    rows = [ROW.format(id=i, state=s) for i, s in enumerate(("tentative", "confirmed", "coasting"))]
    tracks = read_tracks(write(tmp_path / "tracks.csv", TRACK_COLUMNS, *rows))
    assert tracks is not None
    assert tracks.track_id.tolist() == [1]
    np.testing.assert_array_equal(tracks.velocity, [[4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(tracks.size, [[4.0, 2.0, 1.5]])
    np.testing.assert_array_equal(tracks.std[0], [0.1, 0.1, 0.1, 0.2, 0.2, 0.2])


def test_sigmas_of_the_box_are_read_by_name_where_they_are(tmp_path: Path) -> None:
    row = ROW.format(id=1, state="confirmed")
    older = read_tracks(write(tmp_path / "tracks.csv", TRACK_COLUMNS, row))
    assert older is not None
    assert np.isnan(older.std_box).all()
    columns = f"{TRACK_COLUMNS},std_yaw,other,std_length,std_width,std_height,std_yaw_rate"
    newer = read_tracks(write(tmp_path / "tracks.csv", columns, f"{row},0.4,9,0.1,0.2,,0.5"))
    assert newer is not None
    np.testing.assert_array_equal(newer.std_box, [[0.1, 0.2, np.nan, 0.4, 0.5]])


def test_a_run_without_these_files(tmp_path: Path) -> None:
    assert read_tracks(tmp_path) is None
    assert read_points(tmp_path) is None
    assert read_matches(tmp_path) is None
    assert read_object_truth(tmp_path) is None


def test_empty_fields_are_unknown(tmp_path: Path) -> None:
    write(tmp_path / "points.csv", "timestamp_ns,feature_id,u,v,z_cam,label", "5,1,2.5,3.5,,static")
    points = read_points(tmp_path)
    assert points is not None
    assert np.isnan(points.depth).tolist() == [True]
    write(tmp_path / "stereo.csv", "timestamp_ns,u,v,u_right,v_right,accepted", "5,1,2,3,4,1",
          "5,1,2,3,4,0")  # fmt: skip
    matches = read_matches(tmp_path)
    assert matches is not None
    assert matches.accepted.tolist() == [True, False]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "tracks.csv: is empty"),
        (["timestamp_ns,track_id,x"], "tracks.csv, row 1: has no column 'y'"),
        ([TRACK_COLUMNS, "5,1"], "tracks.csv, row 2: 2 columns where 25"),
        ([TRACK_COLUMNS, ROW.format(id="one", state="confirmed")], "tracks.csv, row 2: is not a"),
        ([TRACK_COLUMNS, *[ROW.format(id=1, state="confirmed")] * 2], "a track twice in one frame"),
    ],
)
def test_a_bad_table(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_tracks(write(tmp_path / "tracks.csv", *lines))


def test_a_label_that_is_none(tmp_path: Path) -> None:
    write(tmp_path / "points.csv", "timestamp_ns,u,v,z_cam,label", "5,2,3,4,moving")
    with pytest.raises(InputError, match=r"points.csv, row 2: 'moving' is no label"):
        read_points(tmp_path)
