"""Synthetic bodies are measured: how many, where, how fast, and how sure."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects import measurement, static_motion
from ovmot.objects.measurement import ObjectMeasurement, measure_objects
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.settings import ObjectSettings, SegmentationSettings
from ovmot.types import PixelNoise, PointLabel, PoseWindow, ScenePoints

Found = tuple[ObjectMeasurement, ...]
Scene = tuple[FeatureTable, ScenePoints, PoseWindow]
SIGMA = 0.3
FRAMES = 12
CALM = ObjectSettings(accel_sigma_mps2=0.0)
NOISE = PixelNoise(SIGMA, SIGMA, 0.0, 0.0)


def history_of(
    table: FeatureTable, points: ScenePoints, window: PoseWindow, rig: StereoRig
) -> StereoHistory:
    spans = SegmentationSettings().look_back_s
    history = stereo_history(table, points.feature_id, window.timestamp_ns, rig, spans, NOISE)
    return history.younger(1.0)


@pytest.fixture(scope="module")
def seen(
    rig: StereoRig, drive: Callable[..., FloatArray], body: Callable[..., FloatArray],
    scene_of: Callable[..., Scene],
) -> Callable[..., tuple[ObjectMeasurement, ...]]:  # fmt: skip
    """Measurements of bodies given as (ahead, left, velocity, yaw rate, points), from a car."""

    def measured(
        bodies: list[tuple[float, float, FloatArray, float, int]], seed: int = 0,
        settings: ObjectSettings = CALM, label: PointLabel = PointLabel.DYNAMIC,
        size: tuple[float, float, float] = (4.0, 1.8, 1.4),
    ) -> tuple[ObjectMeasurement, ...]:  # fmt: skip
        rng = np.random.default_rng(seed)
        T = drive(FRAMES)
        parts = []
        for ahead, left, velocity, yaw_rate, n in bodies:
            centre = se3.apply(T[-1], np.array([ahead, left, 0.0]))
            parts.append(body(FRAMES, n, centre, velocity, yaw_rate, rng, size))
        table, points, window = scene_of(rig, T, np.concatenate(parts, axis=1), SIGMA, rng)
        points = replace(points, label=np.full_like(points.label, int(label)))
        return measure_objects(
            history_of(table, points, window, rig), points, window, rig, settings,
            SegmentationSettings(),
            np.random.default_rng(1),
        )  # fmt: skip

    return measured


def test_a_translating_body(seen: Callable[..., Found], drive: Callable[..., FloatArray]) -> None:
    velocity = np.array([-9.0, 1.0, 0.0])
    (found,) = seen([(18.0, 2.0, velocity, 0.0, 15)])
    centre = se3.apply(drive(FRAMES)[-1], np.array([18.0, 2.0, 0.0]))
    assert np.linalg.norm(found.velocity - velocity) < 0.4
    assert np.linalg.norm(found.position - centre) < 0.8
    assert len(found.feature_id) >= 13
    assert found.p_world.shape == (len(found.feature_id), 3)
    before = se3.apply(se3.inverse(found.T_now_before), found.position)
    np.testing.assert_allclose(found.position - before, found.velocity * found.span_s, atol=0.05)
    assert found.size[0] == pytest.approx(4.0, abs=1.2)


def test_a_turning_body_has_its_velocity(seen: Callable[..., Found]) -> None:
    velocity = np.array([5.0, 0.0, 0.0])
    (found,) = seen([(12.0, 0.0, velocity, 0.4, 25)])
    turn = se3.log(found.T_now_before)[2] / found.span_s
    assert turn == pytest.approx(0.4, abs=0.15)
    assert np.linalg.norm(found.velocity - velocity) < 0.4


def test_two_bodies_that_touch_but_move_apart(seen: Callable[..., Found]) -> None:
    bodies = [
        (15.0, 1.2, np.array([7.0, 0.0, 0.0]), 0.0, 20),
        (15.0, -1.2, np.array([4.0, 0.0, 0.0]), 0.0, 15),
    ]
    found = seen(bodies)
    assert len(found) == 2
    ids = [set(m.feature_id.tolist()) for m in found]
    assert ids[0] <= set(range(100, 120)) and ids[1] <= set(range(120, 135))
    assert found[0].velocity[0] == pytest.approx(7.0, abs=0.4)
    assert found[1].velocity[0] == pytest.approx(4.0, abs=0.4)


def test_bodies_far_apart_with_one_velocity_are_two(seen: Callable[..., Found]) -> None:
    velocity = np.array([6.0, 0.0, 0.0])
    found = seen([(12.0, 3.5, velocity, 0.0, 15), (12.0, -3.5, velocity, 0.0, 15)])
    assert len(found) == 2


def test_points_called_unknown_or_static_are_found_where_they_move_together(
    seen: Callable[..., Found],
) -> None:
    bodies = [(14.0, 0.0, np.array([0.0, 3.0, 0.0]), 0.0, 10)]
    for label in (PointLabel.UNKNOWN, PointLabel.STATIC):
        assert len(seen(bodies, label=label, size=(1.8, 4.0, 1.4))) == 1


@pytest.mark.parametrize("test", ["covariance", "fixed"])
def test_what_stands_is_refused_whatever_its_label(seen: Callable[..., Found], test: str) -> None:
    settings = CALM.model_copy(update={"static_test": test})
    rest = np.zeros(3)
    for seed in range(10):
        bodies = [(12.0, 2.0, rest, 0.0, 20), (25.0, -4.0, rest, 0.0, 20)]
        assert seen(bodies, seed, settings) == ()
    walker = [(8.0, 0.0, np.array([0.0, 1.4, 0.0]), 0.0, 8)]
    assert len(seen(walker, 0, settings, size=(0.5, 0.7, 1.7))) == 1


def test_a_far_body_is_measured_though_only_what_crosses_is_known(
    seen: Callable[..., Found], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (measurement, static_motion):
        monkeypatch.setattr(module, "MAX_SIGMA_MPS", 0.2)
    (found,) = seen([(35.0, 0.0, np.array([0.0, 8.0, 0.0]), 0.0, 8)])
    sigma = np.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1])
    assert sigma > 0.2
    assert found.velocity[1] == pytest.approx(8.0, abs=0.5)
    assert seen([(35.0, 0.0, np.array([2.0, 0.0, 0.0]), 0.0, 8)]) == ()


def test_what_is_high_up_is_no_road_user(
    seen: Callable[..., Found], monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = [(20.0, 0.0, np.array([0.0, 5.0, 0.0]), 0.0, 12)]
    assert len(seen(bodies)) == 1
    monkeypatch.setattr(measurement, "MAX_VEHICLE_SIZE_M", (0.0, 0.0, -3.0))  # a road far below
    assert seen(bodies) == ()


def test_two_points_are_no_body(seen: Callable[..., Found]) -> None:
    assert seen([(12.0, 0.0, np.array([8.0, 0.0, 0.0]), 0.0, 2)]) == ()


def test_points_close_together_tell_a_velocity(seen: Callable[..., Found]) -> None:
    velocity = np.array([3.0, 6.0, 0.0])
    (found,) = seen([(30.0, 0.0, velocity, 0.0, 4)], size=(0.1, 0.2, 0.2))
    sigma = np.sqrt(np.diag(found.covariance)[3:])
    assert np.all(np.abs(found.velocity - velocity) < 4.0 * sigma)


def test_the_same_seed_gives_the_same_numbers(seen: Callable[..., Found]) -> None:
    bodies = [(15.0, 1.0, np.array([7.0, 1.0, 0.0]), 0.1, 12)]
    (a,), (b,) = seen(bodies), seen(bodies)
    np.testing.assert_array_equal(a.velocity, b.velocity)
    np.testing.assert_array_equal(a.p_world, b.p_world)


def test_the_velocity_covariance_is_consistent(seen: Callable[..., Found]) -> None:
    nees = []
    for seed in range(60):
        velocity = np.array([-4.0 + 0.2 * seed, 3.0, 0.0])
        (found,) = seen([(16.0 + 0.1 * seed, 0.0, velocity, 0.0, 12)], seed)
        e, C = found.velocity - velocity, found.covariance[3:, 3:]
        nees.append(e @ np.linalg.solve(C, e))
    # 3 degrees of freedom; the weak prior on turns says more than nothing where none is turning
    assert 1.5 < np.mean(nees) < 6.0


def test_uncertain_poses_widen_the_velocity(
    rig: StereoRig, drive: Callable[..., FloatArray], body: Callable[..., FloatArray],
    scene_of: Callable[..., Scene],
) -> None:  # fmt: skip
    rng = np.random.default_rng(5)
    T = drive(FRAMES)
    centre = se3.apply(T[-1], np.array([14.0, 0.0, 0.0]))
    p = body(FRAMES, 15, centre, np.array([6.0, 0.0, 0.0]), 0.0, rng)
    table, points, window = scene_of(rig, T, p, SIGMA, rng)
    sure, unsure = (
        measure_objects(
            history_of(table, points, window, rig), points,
            replace(window, covariance=window.covariance * scale), rig, CALM,
            SegmentationSettings(),
            np.random.default_rng(1),
        )[0]
        for scale in (1e-6, 1e2)
    )  # fmt: skip
    # independent errors of 1 cm at both times
    added = unsure.covariance[3, 3] - sure.covariance[3, 3]
    assert added > 0.5 * 2.0 * 1e-4 / unsure.span_s**2
    assert unsure.covariance[1, 1] - sure.covariance[1, 1] > 0.9e-4
    assert np.linalg.eigvalsh(unsure.covariance).min() > 0.0
