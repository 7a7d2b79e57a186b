"""ROS bags as sequences: topics, encodings, calibration, and each mistake as one line."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.datasets.bag.file import bag_at
from ovmot.datasets.bag.topics import BagTopics, find_topics
from ovmot.datasets.registry import open_recording
from ovmot.datasets.stream import events
from ovmot.errors import CalibrationError, DatasetError, InputError
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.values import Message, Published, Value, header, image, vector
from ovmot.types import StereoFrame

START_NS = 1_700_000_000_000_000_000
WIDTH, HEIGHT = 32, 24
IMAGE, COMPRESSED, IMU = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/Imu"
COLOURS = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
ImageMaker = Callable[[int], Message]

_CAMERA = """
  intrinsics: [20.0, 21.0, 16.0, 12.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.001, 0.0002]
  resolution: [32, 24]
"""
_MOUNT = """\
cam0:
  T_cam_imu: [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
  timeshift_cam_imu: 0.002
"""
_CHAIN = f"{_MOUNT.rstrip()}{_CAMERA}cam1:\n  T_cn_cnm1: \
[[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]{_CAMERA}"


def mono(stamp: int) -> Message:
    return image(stamp, "cam", COLOURS[:, :, 0])


def encoded(encoding: str, pixels: np.ndarray, padding: int = 0) -> ImageMaker:
    """Images of an encoding, rows padded by some bytes."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(HEIGHT, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)

    def make_image(stamp: int) -> Message:
        size: dict[str, Value] = {"height": HEIGHT, "width": WIDTH, "step": rows.shape[1]}
        data = rows.reshape(-1)
        described: dict[str, Value] = {"header": header(stamp, "cam"), "encoding": encoding}
        return Message(IMAGE, {**described, **size, "data": data})

    return make_image


def compressed(file_format: str, ending: str = ".png", pixels: np.ndarray = COLOURS) -> ImageMaker:
    data = cv2.imencode(ending, pixels)[1].reshape(-1)
    fields: dict[str, Any] = {"format": file_format, "data": data}
    return lambda stamp: Message(COMPRESSED, {"header": header(stamp, "cam"), **fields})


def camera_info(
    right: bool, version: int = 1, model: str = "plumb_bob"
) -> Callable[[int], Message]:
    shift = -20.0 * 0.3 if right else 0.0
    matrices = {
        "D": [-0.1, 0.01, 0.0, 0.0, 0.0],
        "K": [20.0, 0, 16.0, 0, 21.0, 12.0, 0, 0, 1],
        "R": np.eye(3).reshape(-1),
        "P": [20.0, 0, 16.0, shift, 0, 20.0, 12.0, 0, 0, 0, 1, 0],
    }
    fields = {
        key if version == 1 else key.lower(): np.array(value) for key, value in matrices.items()
    }
    size: dict[str, Value] = {"height": HEIGHT, "width": WIDTH, "distortion_model": model}
    return lambda stamp: Message(
        "sensor_msgs/CameraInfo", {"header": header(stamp, "cam"), **size, **fields}
    )


def imu(stamp: int) -> Message:
    rates = {
        "angular_velocity": vector(np.array([0.1, 0.2, 0.3])),
        "linear_acceleration": vector(np.array([0.0, 0.5, 9.8])),
    }
    return Message(IMU, {"header": header(stamp, "imu"), **rates})


def write_bag(
    path: Path, cameras: Mapping[str, ImageMaker], imus: tuple[str, ...] = ("/imu",)
) -> Path:
    """Six frames of 10 Hz, and IMUs of 100 Hz around them; recorded a bit after their stamps."""
    with BagWriter(path) as bag:
        for tick in range(-5, 56):
            stamp = START_NS + tick * 10_000_000
            for topic in imus:
                bag.write(Published(topic, imu(stamp)), stamp + 1000)
            if tick % 10 == 0:
                for i, (topic, make_image) in enumerate(cameras.items()):
                    bag.write(Published(topic, make_image(stamp)), stamp + 2_000_000 * (i + 1))
    return path


def frames(path: Path, chain: Path, **topics: str) -> list[StereoFrame]:
    bag = open_recording(path, calibration=chain, topics=BagTopics(**topics))
    return [event for event in events(bag) if isinstance(event, StereoFrame)]


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    path = tmp_path / "chain.yaml"
    path.write_text(_CHAIN)
    return path


@pytest.fixture
def mount(tmp_path: Path) -> Path:
    path = tmp_path / "mount.yaml"
    path.write_text(_MOUNT)
    return path


GREY = cv2.cvtColor(COLOURS, cv2.COLOR_BGR2GRAY)
DEEP = COLOURS[:, :, 0].astype(np.uint16) * 256 + 99


@pytest.mark.parametrize(
    ("make_image", "expected"),
    [
        (encoded("mono8", COLOURS[:, :, 0], padding=5), COLOURS[:, :, 0]),
        (encoded("mono16", DEEP), COLOURS[:, :, 0]),
        (encoded("mono16", DEEP, padding=4), COLOURS[:, :, 0]),
        (encoded("bgr8", COLOURS, padding=1), GREY),
        (encoded("rgb8", COLOURS[:, :, ::-1]), GREY),
        (encoded("bgra8", cv2.cvtColor(COLOURS, cv2.COLOR_BGR2BGRA)), GREY),
        (compressed("bgr8; png compressed bgr8"), GREY),
        (compressed("png", pixels=COLOURS[:, :, 0]), COLOURS[:, :, 0]),
    ],
)
@pytest.mark.parametrize("ending", [".bag", ".mcap"])
def test_encodings_become_grey(
    tmp_path: Path, chain: Path, make_image: ImageMaker, expected: np.ndarray, ending: str
) -> None:
    path = write_bag(tmp_path / f"tiny{ending}", {"/left": make_image, "/right": make_image})
    seen = frames(path, chain)
    assert len(seen) == 6
    for seen_image in (seen[0].left, seen[5].right):  # libpng rounds colours down
        assert np.abs(seen_image.astype(int) - expected).max() <= (expected is GREY)


def test_jpeg_is_close_and_broken_jpeg_is_an_error(tmp_path: Path, chain: Path) -> None:
    smooth = cv2.GaussianBlur(COLOURS, (9, 9), 3.0)
    jpeg = compressed("jpeg", ".jpg", smooth)
    path = write_bag(tmp_path / "tiny.bag", {"/left": jpeg, "/right": jpeg})
    difference = frames(path, chain)[0].left.astype(int) - cv2.cvtColor(smooth, cv2.COLOR_BGR2GRAY)
    assert np.abs(difference).max() < 12

    def half(stamp: int) -> Message:
        whole = jpeg(stamp)
        data = np.asarray(whole.fields["data"])
        return Message(whole.type_name, {**whole.fields, "data": data[: len(data) // 2]})

    path = write_bag(tmp_path / "half.bag", {"/left": jpeg, "/right": half})
    with pytest.raises(DatasetError, match=r"half\.bag, topic /right, image \d+ ns: .*truncated"):
        frames(path, chain)


@pytest.mark.parametrize(
    ("encoding", "first_rows"),
    [
        ("bayer_rggb8", "rg/gb"),
        ("bayer_bggr8", "bg/gr"),
        ("bayer_gbrg8", "gb/rg"),
        ("bayer_grbg8", "gr/bg"),
    ],
)
def test_a_bayer_pattern_is_read_by_its_first_rows(
    tmp_path: Path, chain: Path, encoding: str, first_rows: str
) -> None:
    """A red wall: red pixels full, the others 0, is 0.299 * 255 in grey everywhere."""
    tile = np.array([[255 * (c == "r") for c in row] for row in first_rows.split("/")])
    mosaic = np.tile(tile, (HEIGHT // 2, WIDTH // 2)).astype(np.uint8)
    png = compressed(f"{encoding}; png compressed ", pixels=mosaic)
    path = write_bag(tmp_path / "tiny.bag", {"/left": encoded(encoding, mosaic), "/right": png})
    frame = frames(path, chain)[0]
    for side in (frame.left, frame.right):
        assert np.abs(side[4:-4, 4:-4].astype(float) - 0.299 * 255).max() < 2


def test_an_unknown_encoding_is_one_line_before_the_run(tmp_path: Path, chain: Path) -> None:
    odd = encoded("yuv422", np.zeros((HEIGHT, WIDTH), dtype=np.uint16))
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": odd})
    with pytest.raises(
        DatasetError, match=r"topic /right.*unknown encoding 'yuv422'; known: mono8"
    ):
        open_recording(path, calibration=chain)


@pytest.mark.parametrize(
    ("images", "asked", "expected"),
    [
        (["/b/left", "/a/right"], {"left": "/b/left"}, ("/b/left", "/a/right")),
        (["/cam1/raw", "/cam0/raw"], {}, ("/cam0/raw", "/cam1/raw")),
        (["/r/left/x", "/r/right/x"], {}, ("/r/left/x", "/r/right/x")),
        (["/a", "/b", "/c"], {"left": "/c", "right": "a"}, ("/c", "/a")),
        (["/a", "/a/compressed", "/b", "/b/compressed"], {}, ("/a", "/b")),
        (
            ["/a", "/a/compressed", "/b", "/b/compressed"],
            {"left": "/a/compressed", "right": "/b/compressed"},
            ("/a/compressed", "/b/compressed"),
        ),
        (["/a/compressed", "/b/compressed"], {}, ("/a/compressed", "/b/compressed")),
    ],
)
def test_cameras_are_found_by_type(
    images: list[str], asked: dict[str, str], expected: tuple[str, str]
) -> None:
    types = {t: COMPRESSED if t.endswith("compressed") else IMAGE for t in images}
    found = find_topics(Path("x.bag"), {**types, "/imu": IMU, "/x": "y/Z"}, BagTopics(**asked))
    assert (found.left, found.right, found.imu) == (*expected, "/imu")


@pytest.mark.parametrize(
    ("types", "asked", "complaint"),
    [
        (
            {"/a": IMAGE, "/b": IMAGE, "/c": IMAGE},
            {},
            "x.bag: holds 3 image topics: /a, /b, /c; choose with --left TOPIC --right TOPIC",
        ),
        (
            {"/a": IMAGE, "/b": IMAGE, "/c": IMAGE},
            {"left": "/b"},
            "x.bag: holds 3 image topics: /a, /b, /c; choose with --right TOPIC",
        ),
        ({"/a": IMAGE}, {}, "x.bag: holds 1 image topics: /a; two cameras are needed"),
        ({"/imu": IMU}, {}, "x.bag: holds no image topics"),
        (
            {"/a": IMAGE, "/b": IMAGE},
            {"right": "/d"},
            "x.bag: no image topic /d (--right); there are: /a, /b",
        ),
        ({"/a": IMAGE, "/b": IMAGE}, {"left": "/a", "right": "/a"}, "left and right are both /a"),
        (
            {"/a": IMAGE, "/b": IMAGE, "/i": IMU, "/j": IMU},
            {},
            "x.bag: holds 2 IMU topics: /i, /j; choose with --imu TOPIC",
        ),
        ({"/a": IMAGE, "/b": IMAGE}, {"imu": "/i"}, "no IMU topic /i (--imu); it has no IMU"),
    ],
)
def test_what_is_not_clear_is_asked(
    types: dict[str, str], asked: dict[str, str], complaint: str
) -> None:
    with pytest.raises(InputError) as found:
        find_topics(Path("x.bag"), types, BagTopics(**asked))
    assert complaint in str(found.value)


@pytest.mark.parametrize(("name", "version"), [("tiny.bag", 1), ("tiny", 2)])
def test_camera_info_and_a_mount_make_a_rig(
    tmp_path: Path, mount: Path, name: str, version: int
) -> None:
    cameras = {
        "/left/image_raw": mono,
        "/right/image_raw": mono,
        "/left/camera_info": camera_info(False, version),
        "/right/camera_info": camera_info(True, version),
    }
    path = write_bag(tmp_path / name, cameras)
    sequence = open_recording(path, calibration=mount)
    rig = sequence.rig
    assert rig.baseline == pytest.approx(0.3)
    assert rig.T_cam1_cam0[0, 3] == pytest.approx(-0.3)
    assert rig.time_offset_s == 0.002
    assert rig.cam0.intrinsics[:4] == pytest.approx([20.0, 21.0, 16.0, 12.0])
    with pytest.raises(CalibrationError, match=r"not where they are on the IMU.*cam0\.T_cam_imu"):
        open_recording(path)


def test_rectified_images_see_through_p(tmp_path: Path, mount: Path) -> None:
    cameras = {
        "/left/image_rect": mono,
        "/right/image_rect": mono,
        "/left/camera_info": camera_info(False),
        "/right/camera_info": camera_info(True),
    }
    rig = open_recording(write_bag(tmp_path / "t.bag", cameras), calibration=mount).rig
    assert rig.cam1.model.name == "none"
    assert rig.cam1.intrinsics[:4] == pytest.approx([20.0, 20.0, 16.0, 12.0])


def test_camera_info_without_a_baseline_or_with_an_odd_lens(tmp_path: Path, mount: Path) -> None:
    cameras = {"/l/image_raw": mono, "/r/image_raw": mono, "/l/camera_info": camera_info(False)}
    alone = write_bag(tmp_path / "alone.bag", {**cameras, "/r/camera_info": camera_info(False)})
    with pytest.raises(CalibrationError, match=r"/r/camera_info\.projection_matrix': P has no"):
        open_recording(alone, calibration=mount)
    info = camera_info(True, model="rational_polynomial")
    odd = write_bag(tmp_path / "odd.bag", {**cameras, "/r/camera_info": info})
    with pytest.raises(CalibrationError, match="unknown camera model 'rational_polynomial'"):
        open_recording(odd, calibration=mount)


def test_without_any_calibration_both_ways_are_named(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/a/left": mono, "/a/right": mono})
    with pytest.raises(CalibrationError) as found:
        open_recording(path)
    assert "no CameraInfo beside /a/left and /a/right; give a Kalibr chain" in str(found.value)


@pytest.mark.parametrize("name", ["tiny.bag", "tiny.mcap", "tiny"])
def test_a_truncated_bag_is_one_line_with_a_remedy(tmp_path: Path, chain: Path, name: str) -> None:
    path = write_bag(tmp_path / name, {"/left": mono, "/right": mono})
    file = path if path.is_file() else next(path.glob("*.db3"))
    data = file.read_bytes()
    for share in (0.0, 0.2, 0.9, 0.999):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(DatasetError) as found:
            frames(path, chain)
        text = str(found.value)
        assert text.startswith(f"{path}: ") and "copy the bag again" in text
        assert "\n" not in text


def test_messages_out_of_order_and_frames_without_a_partner(tmp_path: Path, chain: Path) -> None:
    path = tmp_path / "tiny.bag"
    with BagWriter(path) as bag:
        # one sample is late, one image has no partner
        for turn, tick in enumerate((-1, 0, 1, 3, 2, 4, 5, 6)):
            stamp, now = START_NS + tick * 10_000_000, START_NS + turn * 10_000_000
            bag.write(Published("/imu", imu(stamp)), now + 1000)
            bag.write(Published("/left", mono(stamp)), now + 2000)
            if tick != 4:
                bag.write(Published("/right", mono(stamp)), now + 3000)
    sequence = open_recording(path, calibration=chain)
    assert sequence.imu is not None and np.all(np.diff(sequence.imu.timestamp_ns) > 0)
    assert sequence.counts["imu_out_of_order"] == 1
    assert sequence.counts["unpaired_images"] == 1
    ticks = [round((f.timestamp_ns - START_NS) / 1e7) for f in frames(path, chain)]
    assert ticks == [-1, 0, 1, 2, 3, 5]


def test_headers_without_stamps(tmp_path: Path, chain: Path) -> None:
    unstamped = image(0, "cam", COLOURS[:, :, 0])
    cameras: dict[str, ImageMaker] = {"/left": lambda _: unstamped, "/right": lambda _: unstamped}
    with pytest.raises(DatasetError, match=r"topic /left: the headers hold no stamps"):
        open_recording(write_bag(tmp_path / "tiny.bag", cameras), calibration=chain)


def test_without_an_imu_the_bag_says_so(tmp_path: Path, chain: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": mono}, imus=())
    sequence = open_recording(path, calibration=chain)
    assert sequence.imu is None
    assert "no topic of type sensor_msgs/Imu" in sequence.warnings[0]


def test_options_that_do_not_fit_the_data(tmp_path: Path, chain: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": mono})
    with pytest.raises(InputError, match="is a bag; leave out '--format kaist'"):
        open_recording(path, format="kaist", calibration=chain)
    with pytest.raises(InputError, match="is no bag; leave out '--imu /imu'"):
        open_recording(tmp_path, topics=BagTopics(imu="/imu"))


def test_a_folder_without_metadata_is_its_only_bag(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny", {"/left": mono, "/right": mono})
    assert bag_at(path) == path
    (path / "metadata.yaml").unlink()
    assert bag_at(path) == path / "tiny.db3"
    assert bag_at(tmp_path) is None


def test_a_mistake_in_a_bag_ends_the_command_with_2(
    tmp_path: Path, ovmot_command: Callable[..., Any]
) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/a": mono, "/b": mono, "/c": mono})
    found = ovmot_command("run", path, "-o", tmp_path / "out")
    assert found.code == 2
    assert found.complaint.endswith("choose with --left TOPIC --right TOPIC")


@pytest.mark.parametrize(
    ("apart_ns", "kept"), [(4_000_000, True), (-3_000_000, True), (6_000_000, False)]
)
def test_left_and_right_may_be_stamped_a_little_apart(
    tmp_path: Path, chain: Path, apart_ns: int, kept: bool
) -> None:
    def right(stamp: int) -> Message:
        return image(stamp + apart_ns, "cam", COLOURS[:, :, 1])

    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": right})
    if not kept:
        with pytest.raises(DatasetError, match="6 left and 6 right images, only 0 pairs"):
            open_recording(path, calibration=chain)
        return
    seen = frames(path, chain)
    assert [f.timestamp_ns for f in seen] == [START_NS + i * 10**8 for i in range(6)]
    assert all(np.array_equal(f.right, COLOURS[:, :, 1]) for f in seen)
