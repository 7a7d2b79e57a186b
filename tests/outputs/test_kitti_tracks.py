"""`objects_kitti.txt`: the fields of a labelled car, what is left out, and TrackEval's reader."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.geometry import se3
from ovmot.outputs.kitti_tracks import KittiTracks, kitti_row
from ovmot.types import FrameResult, ObjectTrack

Maker = Callable[[int], FrameResult]
CAMERA = Camera.make((1242, 375), (721.5, 721.5), (609.6, 172.9))
# a camera that looks along the world's x axis, 1.6 m above its origin
T_CAM0_WORLD = se3.make(
    np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.0, 1.6, 0.0])
)  # fmt: skip
# a car of training sequence 0010, as it is labelled there
LABEL = (
    "0 0 Car 0 0 -1.779933 602.400132 174.171576 684.834784 236.780777"
    " 1.609268 1.664986 3.204451 0.831016 1.670731 20.433112 -1.740733"
)


@pytest.fixture
def labelled(make_result: Maker) -> ObjectTrack:
    """The labelled car as a track in the world: z up, the box's middle, yaw from x to y."""
    height, width, length, x, y, z, rotation_y = map(float, LABEL.split()[10:])
    (track,) = make_result(0).tracks
    return replace(
        track, track_id=0, position=np.array([z, -x, 1.6 - y + 0.5 * height]),
        yaw=-rotation_y - 0.5 * np.pi, size=np.array([length, width, height]),
        box_px=np.array([602.400132, 174.171576, 684.834784, 236.780777]),
        velocity=np.array([14.0, 2.0, 0.0]), n_points=20,
    )  # fmt: skip


def written(path: Path, *results: FrameResult, numbers: dict[int, int]) -> list[list[str]]:
    table = KittiTracks(path, CAMERA, numbers)
    for result in results:
        table.write(result)
    table.close()
    return [line.split(" ") for line in path.read_text().splitlines()]


def seen_from(result: FrameResult, *tracks: ObjectTrack) -> FrameResult:
    """The result with the camera at `T_CAM0_WORLD`, the IMU 1 m behind it."""
    T_imu_cam0 = se3.make(np.eye(3), np.array([0.0, 0.0, 1.0]))
    T_world_imu = se3.inverse(T_CAM0_WORLD) @ se3.inverse(T_imu_cam0)
    ego = replace(result.ego, T_world_imu=T_world_imu, T_imu_cam0=T_imu_cam0)
    return replace(result, ego=ego, tracks=tracks)


def test_a_labelled_car_has_the_fields_of_its_label(
    tmp_path: Path, make_result: Maker, labelled: ObjectTrack
) -> None:
    (row,) = written(tmp_path / "k", seen_from(make_result(5), labelled), numbers={5: 0})
    label = LABEL.split()
    assert len(row) == len(label) + 1
    assert row[:5] == ["0", "0", "Car", "-1", "-1"]
    np.testing.assert_allclose(
        [float(x) for x in row[6:17]], [float(x) for x in label[6:]], atol=0.006
    )
    assert float(row[5]) == pytest.approx(float(label[5]), abs=0.01)  # labels: of the grey camera
    assert row[17] == "20"


def test_rows_have_the_number_of_their_frame(
    tmp_path: Path, make_result: Maker, labelled: ObjectTrack
) -> None:
    results = [seen_from(make_result(stamp), labelled) for stamp in (700, 900)]
    rows = written(tmp_path / "k", *results, numbers={500: 0, 700: 7, 900: 9})
    assert [row[0] for row in rows] == ["7", "9"]


@pytest.mark.parametrize("state", ["tentative", "coasting"])
def test_what_is_not_confirmed_is_left_out(
    tmp_path: Path, make_result: Maker, labelled: ObjectTrack, state: str
) -> None:
    result = seen_from(make_result(5), replace(labelled, state=state))
    assert written(tmp_path / "k", result, numbers={5: 0}) == []


def test_boxes_end_at_the_edge_of_the_image(labelled: ObjectTrack) -> None:
    across = replace(labelled, box_px=np.array([-80.0, 100.0, 40.0, 500.0]))
    row = kitti_row(across, T_CAM0_WORLD, CAMERA)
    assert row is not None
    assert row[3:7] == (-0.5, 100.0, 40.0, 374.5)


@pytest.mark.parametrize("box", [[-80.0, 100.0, -3.0, 200.0], [float("nan")] * 4])
def test_a_body_out_of_the_image_has_no_row(labelled: ObjectTrack, box: list[float]) -> None:
    assert kitti_row(replace(labelled, box_px=np.array(box)), T_CAM0_WORLD, CAMERA) is None


@pytest.mark.parametrize(
    ("probability", "kind"),
    [
        ((0.7, 0.2, 0.1), "Pedestrian"),
        ((0.3, 0.6, 0.1), "Cyclist"),
        ((0.1, 0.2, 0.7), "Car"),
        ((float("nan"),) * 3, "Misc"),
    ],
)
def test_the_type_is_the_most_probable_class(
    labelled: ObjectTrack, probability: tuple[float, ...], kind: str
) -> None:
    track = replace(labelled, class_probability=np.array(probability))
    row = kitti_row(track, T_CAM0_WORLD, CAMERA)
    assert row is not None
    assert row[1] == kind


def test_trackeval_reads_it(tmp_path: Path, make_result: Maker, labelled: ObjectTrack) -> None:
    """Two cars over three frames, one lost in the last: as labels and as a run's tracks."""
    datasets = pytest.importorskip("trackeval.datasets")
    second = replace(
        labelled, track_id=4, position=labelled.position + np.array([0.0, 9.0, 0.0]),
        box_px=np.array([300.0, 170.0, 380.0, 230.0]),
    )  # fmt: skip
    results = [seen_from(make_result(k), labelled, *([second] if k < 2 else [])) for k in range(3)]
    labels, tracks = tmp_path / "labels", tmp_path / "tracks" / "ovmot" / "data"
    (labels / "label_02").mkdir(parents=True)
    tracks.mkdir(parents=True)
    written(tracks / "0010.txt", *results, numbers={k: k for k in range(3)})
    truth = [seen_from(make_result(k), labelled, second) for k in range(3)]
    rows = written(tmp_path / "truth", *truth, numbers={k: k for k in range(3)})
    text = "".join(" ".join([*row[:3], "0", "0", *row[5:17]]) + "\n" for row in rows)
    (labels / "label_02" / "0010.txt").write_text(text)
    (labels / "evaluate_tracking.seqmap.training").write_text("0010 empty 000000 000003\n")
    data = datasets.Kitti2DBox(
        {
            "GT_FOLDER": str(labels), "TRACKERS_FOLDER": str(tmp_path / "tracks"),
            "TRACKERS_TO_EVAL": ["ovmot"], "CLASSES_TO_EVAL": ["car"], "PRINT_CONFIG": False,
            "OUTPUT_FOLDER": str(tmp_path / "out"),
        }
    )  # fmt: skip
    raw = data.get_raw_seq_data("ovmot", "0010")
    found = data.get_preprocessed_seq_data(raw, "car")
    assert (found["num_gt_dets"], found["num_tracker_dets"], found["num_tracker_ids"]) == (6, 5, 2)
    np.testing.assert_allclose(np.diag(found["similarity_scores"][0]), 1.0)
