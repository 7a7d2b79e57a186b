"""Fixtures that tests of several folders share."""

# isort: off
import ovmot  # noqa: F401 - before NumPy, so that BLAS runs one thread, as it does in a run

# isort: on
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.cli import app as cli
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.registry import open_sequence
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.run import RunOptions, run_sequence
from ovmot.run_evaluation import evaluate
from ovmot.settings import Settings
from ovmot.sim.recording import record
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.types import StereoFrame


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, and one worker has all tests of a compiled kernel.

    So each kernel is compiled once and not by every worker (`--dist loadgroup`).
    """
    for item in items:
        if item.path.stem.endswith("_kernel"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """The one line that says what is wrong; nothing else may stand there."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        return lines[0]


@pytest.fixture
def ovmot_command(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., Outcome]:
    """Runs `ovmot` with these arguments in this process."""

    def command(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["ovmot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capfd.readouterr()
        code = ended.value.code
        return Outcome(code if isinstance(code, int) else int(code is not None), *captured)

    return command


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder with real sequences; the test skips where it is missing."""
    repository = Path(__file__).resolve().parents[1]
    root = Path(os.environ.get("OVMOT_DATA", repository.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no data in {root}; set OVMOT_DATA to run this test")
    return root


@pytest.fixture(scope="session")
def euroc_error_m(data_root: Path, tmp_path_factory: pytest.TempPathFactory) -> float:
    """ATE of the ego motion on MH_01 as it was recorded, metres, SE(3)-aligned.

    Tests that use it are of the group `euroc`, so that it is run once.
    """
    data, out = data_root / "euroc_mh01", tmp_path_factory.mktemp("euroc") / "run"
    run_sequence(open_sequence(data), Settings(), RunOptions(out, threads=2))
    ate = evaluate(out, data).scalars()["ate_se3_m"]
    assert ate is not None
    return ate


@pytest.fixture(scope="session")
def simulated_street(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A function (scene of the catalog) to its folder in KAIST's layout, with truth.

    7 s at 10 Hz, pictures of 320x140; each is rendered once.
    """
    root = tmp_path_factory.mktemp("streets")

    def street(scene: str) -> Path:
        folder = root / scene
        if not folder.exists():
            simulation = make_simulation(load_scene(scene), seed=1, size=(320, 140), duration_s=7.0)
            for _ in write_kaist(folder, record(simulation, 1)):
                pass
        return folder

    return street


@pytest.fixture(scope="session")
def central_differences() -> Callable[..., FloatArray]:
    """Derivative (..., m, n) of function (n,) -> (..., m) at a point (n,), by central steps."""

    def derivative(
        function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-6
    ) -> FloatArray:
        steps = step * np.eye(len(at))
        columns = [(function(at + d) - function(at - d)) / (2.0 * step) for d in steps]
        return np.stack(columns, axis=-1)

    return derivative


@pytest.fixture(scope="session")
def painted_rig() -> StereoRig:
    """Two 320x240 pinhole cameras, 0.3 m apart, looking along x of an IMU that stands upright."""
    camera = Camera.make((320, 240), (200.0, 200.0), (159.5, 119.5))
    R_imu_cam = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return StereoRig(
        camera,
        camera,
        se3.make(R_imu_cam, np.zeros(3)),
        se3.make(R_imu_cam, np.array([0.0, -0.3, 0.0])),
    )


@pytest.fixture(scope="session")
def painted_pair() -> Callable[..., StereoFrame]:
    """A stereo pair of `painted_rig` before painted walls: (stamp_ns, camera y, body y) -> frame.

    Upper half: a wall 8 m away, lower half: one 5 m away. A body 6 m away covers 80x80 pixels of
    the middle. Camera and body move along the world's y (to the left), metres; rotation is zero,
    so every image is exact up to interpolation. `lift_right` shifts a box of the right image
    (columns 200 to 280) up by that many pixels: matches there break the epipolar constraint.
    """
    rng = np.random.default_rng(5)
    walls = [_paint(rng, 240, 1600) for _ in range(2)]
    body = _paint(rng, 80, 84)

    def view(camera_y: float, body_y: float) -> Image:
        out = np.empty((240, 320))
        for rows, wall, depth in ((slice(0, 120), 0, 8.0), (slice(120, 240), 1, 5.0)):
            out[rows] = _columns(walls[wall], 640.0 - 200.0 * camera_y / depth, 320)[rows]
        u = 120.0 + 200.0 * (camera_y - body_y) / 6.0
        first = int(np.ceil(u))
        out[80:160, first : first + 80] = _columns(body, first - u, 80)
        return np.asarray(np.round(out), dtype=np.uint8)

    def pair(
        timestamp_ns: int, camera_y: float = 0.0, body_y: float = 0.0, lift_right: int = 0
    ) -> StereoFrame:
        left, right = view(camera_y, body_y), view(camera_y - 0.3, body_y)
        if lift_right:
            right[:, 200:280] = np.roll(right[:, 200:280], -lift_right, axis=0)
        return StereoFrame(timestamp_ns, left, right)

    return pair


_FINE = 4


def _paint(rng: np.random.Generator, height: int, width: int) -> FloatArray:
    """A texture of blobs some pixels wide, grey 20 to 235; four columns to a pixel."""
    noise = rng.standard_normal((height, _FINE * width)).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), sigmaX=1.8 * _FINE, sigmaY=1.8).astype(np.float32)
    return np.asarray(np.clip(128.0 + 60.0 * noise / noise.std(), 20.0, 235.0), dtype=np.float64)


def _columns(texture: FloatArray, u: float, count: int) -> FloatArray:
    """So many columns of a texture, one a pixel, from a fractional pixel on."""
    i = int(np.floor(_FINE * u))
    a, stop = _FINE * u - i, i + _FINE * count
    out: FloatArray = (1.0 - a) * texture[:, i:stop:_FINE] + a * texture[
        :, i + 1 : stop + 1 : _FINE
    ]
    return out


EUROC_START_NS = 1_403_636_580_000_000_000

_SENSOR = """\
T_BS: {{cols: 4, rows: 4, data: {matrix}}}
resolution: [320, 240]
camera_model: pinhole
intrinsics: [200.0, 200.0, 159.5, 119.5]
distortion_model: radial-tangential
distortion_coefficients: [0.0, 0.0, 0.0, 0.0]
"""
_IMU = """\
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
gyroscope_noise_density: 1.0e-4
gyroscope_random_walk: 1.0e-5
accelerometer_noise_density: 1.0e-3
accelerometer_random_walk: 1.0e-4
"""


@pytest.fixture
def painted_euroc(
    tmp_path: Path, painted_rig: StereoRig, painted_pair: Callable[..., StereoFrame]
) -> Path:
    """A EuRoC folder of 12 pairs in 1.1 s: the rig stands, the painted body crosses at 1.5 m/s."""
    root = tmp_path / "painted" / "mav0"
    stamps = [EUROC_START_NS + 10**8 * i for i in range(12)]
    mounts = (painted_rig.T_imu_cam0, painted_rig.T_imu_cam1)
    for name, mount in zip(("cam0", "cam1"), mounts, strict=True):
        (root / name / "data").mkdir(parents=True)
        listed = "".join(f"{stamp},{stamp}.png\n" for stamp in stamps)
        (root / name / "data.csv").write_text(f"#timestamp [ns],filename\n{listed}")
        matrix = mount.ravel().tolist()
        (root / name / "sensor.yaml").write_text(_SENSOR.format(matrix=matrix))
    for i, stamp in enumerate(stamps):
        pair = painted_pair(stamp, 0.0, 0.15 * i)
        cv2.imwrite(str(root / "cam0" / "data" / f"{stamp}.png"), pair.left)
        cv2.imwrite(str(root / "cam1" / "data" / f"{stamp}.png"), pair.pair[1])
    (root / "imu0").mkdir()
    rng = np.random.default_rng(0)
    rates = rng.normal(0.0, 1e-3, (241, 6))
    rates[:, 5] += 9.81
    rows = [
        f"{stamps[0] - 10_000_000 + 5_000_000 * k}," + ",".join(f"{x:.9f}" for x in row)
        for k, row in enumerate(rates.tolist())
    ]
    (root / "imu0" / "data.csv").write_text(
        "#timestamp [ns],w,w,w,a,a,a\n" + "\n".join(rows) + "\n"
    )
    (root / "imu0" / "sensor.yaml").write_text(_IMU)
    return root.parent
