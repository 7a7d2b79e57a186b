"""Files of objects, points and matches: what is wrong is said in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.truth import read_object_truth
from ovmot.errors import InputError
from ovmot.outputs.run_reader import read_matches, read_points, read_tracks

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


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[{", "cannot be read"),
        ("{}", "not a list of frames"),
        ("[{}]", "frame 0 lacks 'objects'"),
        ('[{"t_ns": 5, "objects": [{"id": 1}]}]', "frame 0 lacks 'x'"),
        ("[5]", "objects.json: "),
    ],
)
def test_bad_object_truth(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "objects.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_object_truth(tmp_path)


def test_an_id_twice(tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    keys = ("x", "y", "z", "yaw", "l", "w", "h", "vx", "vy", "yaw_rate", "visible_px")
    car = {**dict.fromkeys(keys, 1.0), "id": 3}
    listed = [{"t_ns": 5, "objects": [car, car]}]
    (tmp_path / "truth" / "objects.json").write_text(json.dumps(listed))
    with pytest.raises(InputError, match="an id twice"):
        read_object_truth(tmp_path)
