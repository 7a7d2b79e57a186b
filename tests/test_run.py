"""A run from a folder to its files."""

import json
import re
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot import run as run_module
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import DatasetError, InputError, OvmotError
from ovmot.geometry import se3
from ovmot.odometry import NO_OBJECTS, Odometry
from ovmot.outputs.finished_run import Run
from ovmot.outputs.run_writer import RunWriter, open_outputs
from ovmot.run import RunOptions, poses_from_file, run_sequence
from ovmot.settings import MaskSettings, ObjectSettings, Settings
from ovmot.types import Event, FrameResult

SETTINGS = Settings.model_validate(
    {
        "tracker": {
            "max_features": 120, "fine_columns": 16, "fast_threshold": 12,
            "equalization": "none", "klt_window_px": 13, "klt_levels": 5,
        },
        "initialization": {"window_s": 0.5},
        "noise": {"pixel_sigma": 0.3},
    }
)  # fmt: skip
START_NS = 1_403_636_580_000_000_000
STAMPS = [START_NS + 10**8 * i for i in range(12)]


def run(data: Path, out: Path, settings: Settings = SETTINGS, **options: Any) -> dict[str, Any]:
    """Run and give `run.json`."""
    run_sequence(open_sequence(data), settings, RunOptions(out, **options))
    return described(out)


def test_single_images_are_run_by_one_camera(painted_euroc: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(painted_euroc, tmp_path / "data"))
    for index, camera in ((8, "cam1"), (9, "cam1"), (10, "cam0")):
        (root / "mav0" / camera / "data" / f"{STAMPS[index]}.png").unlink()
    found = run(root, tmp_path / "out")
    assert found["counts"]["frames_read"] == found["input"]["n_frames"] == len(STAMPS)
    assert found["counts"]["unpaired_images"] == 3
    said = [w for w in found["warnings"] if "without a partner" in w["message"]]
    assert len(said) == 1
    assert set(STAMPS[8:11]) <= set(stamps_in(tmp_path / "out" / "state.csv"))


def described(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "run.json").read_text())
    return found


def stamps_in(path: Path) -> list[int]:
    """The first column of a csv file, each once; all rows must be whole."""
    text = path.read_text()
    assert text.endswith("\n")
    header, *rows = text.splitlines()
    assert all(row.count(",") == header.count(",") for row in rows)
    return sorted({int(row.split(",")[0]) for row in rows})


def tum_of_rest(stamps: list[int]) -> str:
    return "".join(f"{ns_to_seconds(t)} 1 2 3 0 0 0 1\n" for t in stamps)


def test_a_run_with_the_filter(painted_euroc: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    told = run(painted_euroc, out, save_points=True)
    assert told["ended"] == "finished"
    counts = told["counts"]
    assert counts["frames_read"] == 12
    assert counts["imu_samples_read"] == 241
    assert counts["frames_never_covered_by_imu"] == 0
    written = stamps_in(out / "state.csv")
    assert counts["frames_written"] == len(written)
    assert STAMPS[-len(written) :] == written
    assert len(written) >= 6
    trajectory = np.loadtxt(out / "trajectory.tum")
    assert np.abs(trajectory[:, 1:4]).max() < 0.01  # it stands
    assert stamps_in(out / "timing.csv") == written
    assert stamps_in(out / "stereo.csv") == written
    points = (out / "points.csv").read_text()
    assert ",dynamic," in points
    assert ",static," in points
    assert told["settings"]["tracker"]["max_features"] == 120
    assert told["input"]["kind"] == "euroc"


def test_the_same_run_twice_is_the_same_bytes(painted_euroc: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        run(painted_euroc, tmp_path / name, save_points=True)
    tables = ("state.csv", "covariance.csv", "tracks.csv", "points.csv", "stereo.csv")
    for file in ("trajectory.tum", *tables):
        a, b = (tmp_path / name / file for name in ("a", "b"))
        assert a.read_bytes() == b.read_bytes(), file
        assert file == "tracks.csv" or a.stat().st_size > 200


def test_without_points_those_files_are_not_there(painted_euroc: Path, tmp_path: Path) -> None:
    run(painted_euroc, tmp_path / "out")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    tables = {"trajectory.tum", "state.csv", "covariance.csv", "tracks.csv", "timing.csv"}
    assert names == {*tables, "objects_kitti.txt", "run.json"}


def test_without_objects_there_is_a_table_without_rows_only(
    painted_euroc: Path, tmp_path: Path
) -> None:
    off = SETTINGS.model_copy(update={"objects": ObjectSettings(enabled=False)})
    run(painted_euroc, tmp_path / "out", off)
    assert not (tmp_path / "out" / "objects_kitti.txt").exists()
    assert (tmp_path / "out" / "tracks.csv").read_text().count("\n") == 1


def test_tracks_have_the_numbers_of_their_frames_in_the_sequence(
    painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Mapping[int, int]] = []

    def spy(*args: Any, **told: Any) -> RunWriter:
        asked.append(told["frame_number"])
        return open_outputs(*args, **told)

    monkeypatch.setattr(run_module, "open_outputs", spy)
    poses = tmp_path / "poses.tum"
    poses.write_text(tum_of_rest(STAMPS))
    run(painted_euroc, tmp_path / "out", ego_poses=poses, first=3, last=7)
    assert asked == [{stamp: i for i, stamp in enumerate(STAMPS)}]


def test_given_poses_of_a_tum_file(painted_euroc: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.tum"
    poses.write_text(tum_of_rest(STAMPS))
    told = run(painted_euroc, tmp_path / "out", ego_poses=poses)
    assert told["counts"]["frames_written"] == 12
    assert told["counts"]["frames_without_pose"] == 0
    assert told["warnings"] == []
    rows = (tmp_path / "out" / "trajectory.tum").read_text().splitlines()
    assert len([r for r in rows if not r.startswith("#")]) == 12
    np.testing.assert_allclose(np.loadtxt(rows)[:, 1:], [[1, 2, 3, 0, 0, 0, 1]] * 12, atol=1e-9)


def test_a_motion_that_is_not_seen_is_said(tmp_path: Path) -> None:
    counts = Counter(
        frames_never_covered_by_imu=3, frames_degraded=7, frames_lost=2, resets=1,
        stereo_matches=100, stereo_matches_refused=60, frames_without_stereo=4,
    )  # fmt: skip
    told = run_module._warnings(Counter(), RunOptions(tmp_path), SETTINGS, counts)
    assert list(told.values()) == [3, 9, 1, 60, 4]
    texts = " ".join(told)
    for part in (
        "never covered",
        "rests on the IMU alone",
        "may jump",
        "by the extrinsics, of 100",
        "ovmot doctor",
    ):
        assert part in texts
    fine = Counter(stereo_matches=100, stereo_matches_refused=15)
    assert not run_module._warnings(Counter(), RunOptions(tmp_path), SETTINGS, fine)


def test_a_dark_right_camera_is_said(painted_euroc: Path, tmp_path: Path) -> None:
    for path in (painted_euroc / "mav0" / "cam1" / "data").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        cv2.imwrite(str(path), np.zeros_like(image))
    told = run(painted_euroc, tmp_path / "out")
    written = told["counts"]["frames_written"]
    assert written > 0
    assert told["counts"]["frames_without_stereo"] == written


def test_refused_stereo_matches_are_counted(painted_euroc: Path, tmp_path: Path) -> None:
    told = run(painted_euroc, tmp_path / "out", save_points=True)
    rows = (tmp_path / "out" / "stereo.csv").read_text().splitlines()[1:]
    assert told["counts"]["stereo_matches"] == len(rows)
    refused = sum(row.endswith(",0") for row in rows)
    assert told["counts"]["stereo_matches_refused"] == refused


def test_frames_without_a_pose_are_left_out_and_counted(
    painted_euroc: Path, tmp_path: Path
) -> None:
    """The file begins at the fourth frame and has a hole; no frame gets another one's pose."""
    poses = tmp_path / "poses.tum"
    there = STAMPS[3:6] + STAMPS[9:]
    lines = [f"{ns_to_seconds(t)} {i} 0 0 0 0 0 1\n" for i, t in enumerate(there)]
    poses.write_text("".join(lines))
    seen: list[int] = []
    sequence = open_sequence(painted_euroc)
    run_sequence(sequence, SETTINGS, RunOptions(tmp_path / "out", poses), seen.append)
    told = described(tmp_path / "out")
    assert told["counts"]["frames_without_pose"] == 6
    assert told["counts"]["frames_written"] == 6
    assert [w["count"] for w in told["warnings"] if "no pose" in w["message"]] == [6]
    assert stamps_in(tmp_path / "out" / "state.csv") == there
    np.testing.assert_allclose(np.loadtxt(tmp_path / "out" / "trajectory.tum")[:, 1], np.arange(6))
    assert seen[-1] == 12


def test_given_poses_of_a_kitti_file(painted_euroc: Path, tmp_path: Path) -> None:
    """Camera poses, a metre forward (z of the camera) in all: x of the world."""
    poses = tmp_path / "0000.txt"
    rows = [f"1 0 0 0 0 1 0 0 0 0 1 {i / 11:.9f}" for i in range(12)]
    poses.write_text("\n".join(rows) + "\n")
    run(painted_euroc, tmp_path / "out", ego_poses=poses)
    trajectory = np.loadtxt(tmp_path / "out" / "trajectory.tum")
    moved = trajectory[:, 1:4] - trajectory[0, 1:4]
    np.testing.assert_allclose(moved[-1], [1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(trajectory[:, 4:], [[0, 0, 0, 1]] * 12, atol=1e-6)


def test_a_kitti_file_of_another_length_is_refused(painted_euroc: Path, tmp_path: Path) -> None:
    poses = tmp_path / "0000.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(InputError, match="1 poses for 12 frames"):
        run(painted_euroc, tmp_path / "out", ego_poses=poses)
    assert not (tmp_path / "out").exists()


def test_a_part_of_the_frames(painted_euroc: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.tum"
    poses.write_text(tum_of_rest(STAMPS))
    run(painted_euroc, tmp_path / "out", ego_poses=poses, first=3, last=7)
    assert stamps_in(tmp_path / "out" / "state.csv") == STAMPS[3:8]
    with pytest.raises(DatasetError, match="frames 0 to 11"):
        run(painted_euroc, tmp_path / "none", ego_poses=poses, first=12)
    assert not (tmp_path / "none").exists()  # so that the corrected command needs no --force


def test_without_imu_and_poses_it_says_what_to_give(painted_euroc: Path, tmp_path: Path) -> None:
    sequence = replace(open_sequence(painted_euroc), imu=None)
    with pytest.raises(InputError, match=r"has no IMU; give the ego motion by --ego poses FILE"):
        run_sequence(sequence, SETTINGS, RunOptions(tmp_path / "out"))


def test_a_run_that_never_starts_fails_and_says_why(painted_euroc: Path, tmp_path: Path) -> None:
    restless = SETTINGS.model_copy(
        update={
            "initialization": SETTINGS.initialization.model_copy(update={"rest_gyro_rps": 1e-9})
        }
    )
    with pytest.raises(OvmotError, match=r"never started.*gyroscope varies"):
        run(painted_euroc, tmp_path / "out", restless)
    told = described(tmp_path / "out")
    assert told["counts"]["frames_written"] == 0
    assert told["ended"].startswith("failed: ")
    assert "never started" in told["ended"]
    counts = told["counts"]
    # a start looks for the time offset, for which the last frames have too little of the IMU
    waiting = counts["frames_before_start"] + counts["frames_never_covered_by_imu"]
    assert waiting == counts["frames_read"]
    assert counts["frames_before_start"] >= 10
    assert told["options"] == {
        "ego": "filter", "start": "found", "ego_poses": None, "masks": None,
        "mask_files": None, "first": 0, "last": None,
    }  # fmt: skip


def test_what_the_segmentation_shows_is_masked(painted_euroc: Path, tmp_path: Path) -> None:
    """Id 5 is the upper half of the left images: no point comes from there."""
    mav, out = painted_euroc / "mav0", tmp_path / "out"
    image = np.zeros((240, 320), dtype=np.uint8)
    image[:120] = 5
    (mav / "cam0" / "segmentation").mkdir()
    for stamp in STAMPS:
        cv2.imwrite(str(mav / "cam0" / "segmentation" / f"{stamp}.png"), image)
    masked = SETTINGS.model_copy(update={"masks": MaskSettings(segmentation_ids=(5,))})
    run(painted_euroc, out, masked, save_points=True)
    rows = np.genfromtxt(out / "points.csv", delimiter=",", names=True)
    assert len(rows) > 200
    assert rows["v"].min() > 115.0
    run(painted_euroc, out, SETTINGS, save_points=True, force=True)
    assert np.genfromtxt(out / "points.csv", delimiter=",", names=True)["v"].min() < 60.0


def test_masks_of_ids_need_segmentation_images(painted_euroc: Path, tmp_path: Path) -> None:
    masked = SETTINGS.model_copy(update={"masks": MaskSettings(segmentation_ids=(5,))})
    with pytest.raises(InputError, match=r"painted: has no instance images; leave out masks"):
        run(painted_euroc, tmp_path / "out", masked)
    assert not (tmp_path / "out").exists()


def test_while_it_waits_it_says_why_once_a_second(painted_euroc: Path, tmp_path: Path) -> None:
    """Twelve frames of 1.1 s: said once, not at the first frame and not at each."""
    restless = SETTINGS.initialization.model_copy(update={"rest_gyro_rps": 1e-9})
    settings = SETTINGS.model_copy(update={"initialization": restless})
    said: list[str] = []
    with pytest.raises(OvmotError, match="never started"):
        run_sequence(
            open_sequence(painted_euroc), settings, RunOptions(tmp_path / "out"),
            on_wait=said.append,
        )  # fmt: skip
    assert len(said) == 1
    assert said[0].startswith(f"no start at frame {STAMPS[10]} ns: static initialization: ")
    assert re.search(r"gyroscope varies by \d+\.\d+ rad/s \(stationary below 1e-09\)", said[0])
    assert re.search(r"dynamic initialization: \d\.\d\d s of frames \(needs 1\.2 s\)", said[0])
    assert described(tmp_path / "out")["not_started_because"] is not None


def test_it_says_so_each_second_and_anew_after_a_reset() -> None:
    """Frames at 10 Hz; there is a start from 2.5 s to 3.5 s."""
    odometry: Any = SimpleNamespace(started=False, not_started_because="too dark")
    frames: list[Any] = [SimpleNamespace(timestamp_ns=START_NS + 10**8 * k) for k in range(60)]
    said: list[str] = []
    for k, _ in enumerate(run_module._saying(iter(frames), odometry, said.append)):
        odometry.started = 25 <= k < 35
    expected = [10, 20, 45, 55]
    assert said == [f"no start at frame {START_NS + 10**8 * k} ns: too dark" for k in expected]


def test_a_run_that_starts_in_time_says_nothing(painted_euroc: Path, tmp_path: Path) -> None:
    said: list[str] = []
    run_sequence(
        open_sequence(painted_euroc), SETTINGS, RunOptions(tmp_path / "out"), on_wait=said.append
    )
    assert said == []


def stop_at(frame: int, error: BaseException) -> Callable[[int], None]:
    """A watcher that raises when so many frames have been read."""

    def on_frame(done: int) -> None:
        if done == frame:
            raise error

    return on_frame


@pytest.mark.parametrize(
    ("error", "ended"),
    [(KeyboardInterrupt(), "interrupted"), (RuntimeError("no luck"), "failed: no luck")],
)
def test_a_run_stopped_in_the_middle_leaves_whole_rows(
    painted_euroc: Path, tmp_path: Path, error: BaseException, ended: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises(type(error)):
        run_sequence(
            open_sequence(painted_euroc), SETTINGS, RunOptions(out, save_points=True),
            stop_at(10, error),
        )  # fmt: skip
    told = described(out)
    assert told["ended"] == ended
    written = stamps_in(out / "state.csv")
    assert told["counts"]["frames_written"] == len(written) > 0
    for name in ("timing.csv", "points.csv", "stereo.csv"):
        assert stamps_in(out / name) == written
    left = [t.name for t in threading.enumerate() if t.name.startswith("ovmot")]
    assert left == []


def test_a_broken_image_in_the_middle_keeps_what_was_done(
    painted_euroc: Path, tmp_path: Path
) -> None:
    image = painted_euroc / "mav0" / "cam1" / "data" / f"{STAMPS[9]}.png"
    image.write_bytes(image.read_bytes()[:-100])
    with pytest.raises(DatasetError, match=f"{STAMPS[9]}.png: the image is truncated"):
        run(painted_euroc, tmp_path / "out")
    told = described(tmp_path / "out")
    assert told["ended"].startswith("failed: ")
    assert "truncated" in told["ended"]
    assert stamps_in(tmp_path / "out" / "state.csv")[-1] <= STAMPS[8]
    assert told["counts"]["frames_read"] == 9


def test_an_existing_run_is_not_overwritten(painted_euroc: Path, tmp_path: Path) -> None:
    run(painted_euroc, tmp_path / "out")
    before = (tmp_path / "out" / "state.csv").read_bytes()
    with pytest.raises(InputError, match="--force"):
        run(painted_euroc, tmp_path / "out")
    assert (tmp_path / "out" / "state.csv").read_bytes() == before
    assert run(painted_euroc, tmp_path / "out", force=True)["ended"] == "finished"


def test_a_pose_that_is_not_finite_ends_the_run(
    painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true_add = Odometry.add

    def add(self: Odometry, event: Event) -> list[FrameResult]:
        broken = np.full((4, 4), np.nan)
        return [
            replace(r, ego=replace(r.ego, T_world_imu=broken)) if r.timestamp_ns > STAMPS[8] else r
            for r in true_add(self, event)
        ]

    monkeypatch.setattr(Odometry, "add", add)
    with pytest.raises(OvmotError, match=f"the pose at {STAMPS[9]} ns is not finite"):
        run(painted_euroc, tmp_path / "out")
    assert stamps_in(tmp_path / "out" / "state.csv")[-1] == STAMPS[8]


def test_camera_poses_are_carried_to_the_imu(painted_euroc: Path, tmp_path: Path) -> None:
    """A pose file of the camera: the camera of the run stands where the file says."""
    poses = tmp_path / "0000.txt"
    poses.write_text("1 0 0 0.5 0 1 0 0 0 0 1 2\n" * 12)
    sequence = open_sequence(painted_euroc)
    start = poses_from_file(str(poses), sequence, SETTINGS)
    T_world_cam0 = start.source.T_world_imu[0] @ sequence.rig.T_imu_cam0
    np.testing.assert_allclose(se3.apply(T_world_cam0, np.zeros(3)), [2.0, -0.5, 0.0], atol=1e-9)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_run_with_one_camera(painted_euroc: Path, tmp_path: Path, threads: int) -> None:
    """At rest it starts without stereo; objects are off, and it says why."""
    shutil.rmtree(painted_euroc / "mav0" / "cam1")
    told = run(painted_euroc, tmp_path / "out", save_points=True, video=True, threads=threads)
    assert told["ended"] == "finished"
    assert told["counts"]["frames_written"] >= 6
    assert np.abs(np.loadtxt(tmp_path / "out" / "trajectory.tum")[:, 1:4]).max() < 0.01
    assert (told["settings"]["tracker"]["cameras"], told["settings"]["objects"]["enabled"]) == (
        "left", False,
    )  # fmt: skip
    said = [warning["message"] for warning in told["warnings"]]
    assert NO_OBJECTS in said
    assert not any("without a stereo match" in text for text in said)
    assert not (tmp_path / "out" / "objects_kitti.txt").exists()
    state = Run(tmp_path / "out").state
    assert np.isnan(state["imu_cam1_x"]).all()
    assert np.isfinite(state["imu_cam0_x"]).all()


def test_the_left_camera_of_two_has_no_objects_either(painted_euroc: Path, tmp_path: Path) -> None:
    tracker = SETTINGS.tracker.model_copy(update={"cameras": "left"})
    left = SETTINGS.model_copy(update={"tracker": tracker})
    told = run(painted_euroc, tmp_path / "left", left)
    assert NO_OBJECTS in [warning["message"] for warning in told["warnings"]]
    off = left.model_copy(update={"objects": ObjectSettings(enabled=False)})
    told = run(painted_euroc, tmp_path / "off", off)  # as asked for: nothing to say
    assert NO_OBJECTS not in [warning["message"] for warning in told["warnings"]]
    assert (tmp_path / "left" / "trajectory.tum").read_bytes() == (
        tmp_path / "off" / "trajectory.tum"
    ).read_bytes()
