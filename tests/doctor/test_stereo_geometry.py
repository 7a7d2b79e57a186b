"""The stereo calibration against matches of points whose place is known."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.models import CAMERA_MODELS
from ovmot.cameras.rig import StereoRig
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Finding, Severity
from ovmot.doctor.stereo_geometry import check_stereo, disparities, fit_of, fitted_extrinsics, moved
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.rigs import fisheye_rig, street_rig


def matches(rig: StereoRig, n: int = 1500, outliers: int = 150) -> FloatArray:
    """Pixels (N, 4) of points 4 to 80 m away, with noise; the last ones are chance."""
    rng = np.random.default_rng(6)
    size = (rig.cam0.width, rig.cam0.height)
    xy = rig.cam0.normalize(rng.uniform((5.0, 5.0), np.subtract(size, 5.0), (n, 2)))
    ray = np.concatenate([xy, np.ones((n, 1))], axis=1)
    p = ray / np.linalg.norm(ray, axis=1, keepdims=True) / rng.uniform(1 / 80, 1 / 4, (n, 1))
    right = rig.cam1.project(se3.apply(rig.T_cam1_cam0, p))
    right[-outliers:] += rng.uniform(-40.0, 40.0, (outliers, 2))
    pixels = np.concatenate([rig.cam0.project(p), right], axis=1)
    pixels += rng.normal(0.0, 0.2, pixels.shape)
    seen = np.isfinite(pixels).all(axis=1) & rig.cam1.inside(pixels[:, 2:])
    return np.asarray(pixels[seen], dtype=np.float64)


def wrong_one(pixels: FloatArray, rig: StereoRig) -> Finding:
    found, _ = check_stereo(pixels, rig, Locations())
    wrong = [f for f in found if f.severity is Severity.WRONG]
    assert len(wrong) == 1
    return wrong[0]


@pytest.mark.parametrize("rig", [street_rig(), fisheye_rig()])
def test_the_true_rig_is_fine(rig: StereoRig) -> None:
    found, best = check_stereo(matches(rig), rig, Locations())
    assert {f.severity for f in found} == {Severity.FINE}
    assert best is rig


def test_swapped_images() -> None:
    rig = street_rig()
    swapped = matches(rig)[:, [2, 3, 0, 1]]
    assert "swapped" in wrong_one(swapped, rig).says
    _, best = check_stereo(swapped, rig, Locations())
    assert fit_of(swapped, best).share > 0.85


def test_inverted_pose() -> None:
    rig = street_rig()
    inverted = replace(rig, T_imu_cam1=rig.T_imu_cam0 @ rig.T_cam1_cam0)
    assert "the other way round" in wrong_one(matches(rig), inverted).says


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("degrees", [-2.0, 2.0])
def test_a_turned_camera_is_measured(axis: int, degrees: float) -> None:
    rig = street_rig()
    delta = np.zeros(5)
    delta[axis] = np.radians(degrees)
    turned = moved(rig, delta)
    assert wrong_one(matches(rig), turned).check == "extrinsics"
    fitted = fitted_extrinsics(matches(rig), turned, np.inf)
    R = fitted.rig.T_cam1_cam0[:3, :3] @ rig.T_cam1_cam0[:3, :3].T
    assert np.degrees(np.linalg.norm(so3.log(R))) < 0.1
    assert abs(np.degrees(fitted.angle) - 2.0) < 0.1


@pytest.mark.parametrize("degrees", [-0.5, 0.0, 0.5])
def test_residuals_of_the_lenses_are_no_wrong_extrinsics(degrees: float) -> None:
    """A lens model leaves some tenths of a pixel, and these look like cameras that squint."""
    rig = street_rig()
    pixels = matches(rig)
    center, size = rig.cam1.intrinsics[2:4], np.array([rig.cam1.width, rig.cam1.height])
    x, y = (2.0 * (pixels[:, 2:] - center) / size).T
    pixels[:, 3] += 0.5 * x * y + 0.2 * (1.0 - y**2)
    squinting = moved(rig, np.radians([0.0, degrees, 0.0, 0.0, 0.0]))
    found, best = check_stereo(pixels, squinting, Locations())
    assert found[0].check == "extrinsics"
    assert found[0].severity is Severity.FINE
    assert best is squinting


@pytest.mark.parametrize("axis", [0, 2])
def test_half_a_degree_is_wrong(axis: int) -> None:
    rig = street_rig()
    turned = moved(rig, np.radians(0.5) * np.eye(5)[axis])
    assert wrong_one(matches(rig), turned).check == "extrinsics"


def test_what_one_half_of_the_frames_shows_alone_is_not_believed() -> None:
    rig = street_rig()
    pixels = matches(rig)
    pixels[: len(pixels) // 2, 3] += 2.5
    pixels[len(pixels) // 2 :, 3] -= 2.5
    found, best = check_stereo(pixels, rig, Locations())
    assert best is rig
    assert found[0].severity is Severity.DOUBTFUL  # hardly a match is explained
    assert "turned" not in found[0].says


def test_a_slightly_turned_camera_is_doubtful() -> None:
    rig = street_rig()
    turned = moved(rig, np.radians([0.15, 0.0, 0.0, 0.0, 0.0]))
    found, _ = check_stereo(matches(rig), turned, Locations())
    assert found[0].severity is Severity.DOUBTFUL


@pytest.mark.parametrize("name", ["radtan", "equidistant"])
def test_lens_models_mixed_up(name: str) -> None:
    """The file names the other model than that whose coefficients it holds."""
    fish = fisheye_rig()
    cameras = [
        replace(c, width=420, height=420, intrinsics=c.intrinsics - [0, 0, 46, 46, 0])
        for c in fish.cameras
    ]
    true_lens = next(n for n in ("radtan", "equidistant") if n != name)
    true = replace(
        fish,
        cam0=replace(cameras[0], model=CAMERA_MODELS[true_lens]),
        cam1=replace(cameras[1], model=CAMERA_MODELS[true_lens]),
    )
    given = replace(
        true,
        cam0=replace(true.cam0, model=CAMERA_MODELS[name]),
        cam1=replace(true.cam1, model=CAMERA_MODELS[name]),
    )
    found = wrong_one(matches(true), given)
    assert found.check == "camera model"
    assert f"'{true_lens}'" in found.says


def test_disparity_is_positive_in_front() -> None:
    rig = street_rig()
    p = np.array([[1.0, 0.5, 10.0], [-2.0, 0.3, 30.0]])
    xy0 = p[:, :2] / p[:, 2:]
    q = se3.apply(rig.T_cam1_cam0, p)
    expected = rig.cam1.fx * rig.baseline / p[:, 2]
    np.testing.assert_allclose(disparities(xy0, q[:, :2] / q[:, 2:], rig), expected, rtol=0.02)


def test_too_few_matches() -> None:
    found, _ = check_stereo(np.zeros((5, 4)), street_rig(), Locations())
    assert [f.severity for f in found] == [Severity.DOUBTFUL]
