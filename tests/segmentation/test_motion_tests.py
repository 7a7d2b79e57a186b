"""The two tests of motion, on measured points with known truth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.segmentation.motion_tests import (
    Evidence,
    Verdict,
    covariance_test,
    fixed_test,
    gather_evidence,
)
from ovmot.segmentation.stereo_history import history_of
from ovmot.settings import SegmentationSettings
from ovmot.types import PixelNoise, PoseWindow

SETTINGS = SegmentationSettings(
    test="covariance", false_alarm=1e-4, forgiven_speed_mps=0.15,
    distance_threshold_m=0.25, reprojection_threshold_px=3.0,
    combine="any",
)  # fmt: skip
NOISE = PixelNoise(0.4, 0.4, 0.0, 0.0)
ROWS = (1, 11, 15, 18, 20)  # of 22 frames at 10 Hz: 2.0, 1.0, 0.6, 0.3 and 0.1 s ago
N_FRAMES = 22
Measured = Callable[..., Evidence]


@pytest.fixture
def evidence_of(
    rig: StereoRig, drive: Callable[..., FloatArray], measure: Callable[..., FloatArray],
    window_of: Callable[..., PoseWindow],
) -> Measured:  # fmt: skip
    """(points in the last camera (N, 3), velocity in its axes (N, 3), rows) -> evidence."""

    def make(
        p_cam: FloatArray,
        velocity: FloatArray | float = 0.0,
        rows: tuple[int, ...] = ROWS,
        seed: int = 0,
        wrong: Callable[[FloatArray], None] = lambda _: None,
        drift_mps: float = 0.0,
        settings: SegmentationSettings = SETTINGS,
    ) -> Evidence:
        T = drive(N_FRAMES)
        T_world_cam = T[-1] @ rig.T_imu_cam0
        age = 0.1 * np.arange(N_FRAMES - 1, -1, -1.0)
        v = np.broadcast_to(velocity, p_cam.shape)
        p = se3.apply(T_world_cam, p_cam[None] - age[:, None, None] * v)
        m = measure(rig, T, p, NOISE.sigma_px, np.random.default_rng(seed))
        wrong(m)
        index = np.array(rows)
        drifting = T.copy()
        drifting[:, 1, 3] -= drift_mps * age
        window = window_of(drifting)
        history = history_of(
            m[index], m[-1], np.arange(len(p_cam)), index, window.timestamp_ns[index], age[index],
            N_FRAMES - 1 - index, rig, NOISE,
        )  # fmt: skip
        return gather_evidence(history, window, rig, settings)

    return make


def scattered(n: int, depth: tuple[float, float], seed: int = 3) -> FloatArray:
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depth, n)
    return np.column_stack([rng.uniform(-0.4, 0.4, n) * z, rng.uniform(-0.15, 0.15, n) * z, z])


def car(x: float, depth: float, n: int = 6, seed: int = 1) -> FloatArray:
    """Points of a body 1.6 m wide, 1 m high."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [x + rng.uniform(-0.8, 0.8, n), rng.uniform(-0.5, 0.5, n), depth + rng.uniform(0, 0.5, n)]
    )


def test_the_false_alarm_rate_is_the_one_set(evidence_of: Measured) -> None:
    """One comparison, nothing forgiven: the share of resting points beyond the bound."""
    for rate in (0.05, 0.01):
        told = SETTINGS.model_copy(update={"false_alarm": rate, "forgiven_speed_mps": 0.0})
        evidence = evidence_of(scattered(10_000, (6.0, 15.0)), rows=(15,), settings=told)
        verdict = covariance_test(evidence, told)
        assert verdict.tested.all()
        assert (verdict.unclear | verdict.moving).mean() == pytest.approx(rate, rel=0.25)
        assert verdict.moving.mean() < rate / 10.0  # chance seldom gives company that goes alike


def test_points_at_rest_are_kept(evidence_of: Measured) -> None:
    verdict = covariance_test(evidence_of(scattered(4000, (4.0, 40.0))), SETTINGS)
    assert verdict.tested.all()
    assert verdict.moving.mean() <= 1e-3
    assert verdict.unclear.mean() <= 2e-3


@pytest.mark.parametrize(
    "velocity",
    [(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0), (1.4, 0.0, 1.4), (0.0, 0.0, 6.0), (0.0, 0.0, -5.0)],
)
def test_a_body_at_15_m_is_found(
    evidence_of: Measured, velocity: tuple[float, float, float]
) -> None:
    """At walking pace across the view; along it, where stereo is poor, at a cyclist's."""
    p = np.concatenate([car(1.0, 15.0), scattered(200, (5.0, 40.0))])
    v = np.zeros_like(p)
    v[:6] = velocity
    verdict = covariance_test(evidence_of(p, v), SETTINGS)
    assert verdict.moving[:6].all()
    assert verdict.moving[6:].mean() < 0.01  # a resting point beside it may be drawn in


def test_the_velocity_is_the_body_s(evidence_of: Measured) -> None:
    velocity = np.array([2.0, -0.5, 0.0])
    rest = evidence_of(car(0.0, 12.0, 300), velocity)
    error = rest.velocity - velocity
    assert rest.explained.mean() > 0.99
    np.testing.assert_allclose(error.mean(0), 0.0, atol=0.05)
    d = np.einsum("ni,nij,nj->n", error, np.linalg.inv(rest.covariance), error)
    assert d.mean() < 3.5  # not more certain than it is; changes of velocity are forgiven
    assert (rest.rows == len(ROWS)).all()


def test_a_lone_wrong_match_is_unclear_and_not_moving(evidence_of: Measured) -> None:
    def shift(m: FloatArray) -> None:
        m[-1, 0, 2:] += (8.0 / 407.0, 0.0)

    p = np.concatenate([[[0.5, 0.0, 9.0]], scattered(100, (5.0, 30.0))])
    verdict = covariance_test(evidence_of(p, wrong=shift), SETTINGS)
    assert verdict.unclear[0]
    assert not verdict.moving.any()
    assert not verdict.unclear[1:].any()


def test_a_lone_moving_point_is_unclear(evidence_of: Measured) -> None:
    p = np.concatenate([[[0.5, 0.0, 9.0]], scattered(100, (5.0, 30.0))])
    v = np.zeros_like(p)
    v[0] = (3.0, 0.0, 0.0)
    verdict = covariance_test(evidence_of(p, v), SETTINGS)
    assert verdict.unclear[0]
    assert not verdict.moving[0]


def test_neighbours_of_different_velocity_are_no_support(evidence_of: Measured) -> None:
    """Two single points a metre apart on opposite ways; with a companion each, they move."""
    p = np.array([[-0.5, 0.0, 10.0], [0.5, 0.0, 10.0]])
    v = np.array([[4.0, 0.0, 0.0], [-4.0, 0.0, 0.0]])
    verdict = covariance_test(evidence_of(p, v), SETTINGS)
    assert verdict.unclear.all()
    assert not verdict.moving.any()
    both = np.concatenate([p, p + np.array([0.0, 0.4, 0.0])])
    assert covariance_test(evidence_of(both, np.tile(v, (2, 1))), SETTINGS).moving.all()


def test_a_drift_of_the_ego_motion_is_forgiven_up_to_its_speed(evidence_of: Measured) -> None:
    p = scattered(300, (4.0, 12.0))
    strict = SETTINGS.model_copy(update={"forgiven_speed_mps": 0.0})
    kind = SETTINGS.model_copy(update={"forgiven_speed_mps": 0.3})
    drifting = evidence_of(p, drift_mps=0.25, settings=strict)
    assert covariance_test(drifting, strict).moving.mean() > 0.5
    verdict = covariance_test(evidence_of(p, drift_mps=0.25, settings=kind), kind)
    assert verdict.moving.mean() < 0.01
    assert verdict.unclear.mean() < 0.01


def test_points_without_a_comparison_are_not_tested(evidence_of: Measured) -> None:
    def blind(m: FloatArray) -> None:
        m[:, 0, 2:] = np.nan
        m[list(ROWS[1:]), 1, 2:] = np.nan

    evidence = evidence_of(car(0.0, 10.0), np.array([3.0, 0.0, 0.0]), wrong=blind)
    verdict = covariance_test(evidence, SETTINGS)
    assert verdict.tested.tolist() == [False] + [True] * 5
    assert verdict.moving[1:].all()


def test_one_comparison_needs_company(evidence_of: Measured) -> None:
    """Seen but once before, two points alike may be wrong matches; three are a body."""
    for n, moves in ((2, False), (3, True)):
        evidence = evidence_of(car(0.0, 10.0, n), np.array([3.0, 0.0, 0.0]), rows=(15,))
        verdict = covariance_test(evidence, SETTINGS)
        assert (verdict.moving == moves).all()
        assert (verdict.unclear == (not moves)).all()


@pytest.mark.parametrize(
    ("combine", "expected"),
    [("any", [False, True, True, True, False]), ("all", [False, False, False, True, False])],
)
def test_fixed_thresholds(evidence_of: Measured, combine: str, expected: list[bool]) -> None:
    evidence = replace(
        evidence_of(car(0.0, 10.0, 5)),
        distance_m=np.array([0.24, 0.26, 0.24, 0.26, np.nan]),
        reprojection_px=np.array([2.9, 2.9, 3.1, 3.1, np.nan]),
    )
    settings = SETTINGS.model_copy(update={"test": "fixed", "combine": combine})
    verdict: Verdict = fixed_test(evidence, settings)
    assert verdict.moving.tolist() == expected
    assert not verdict.unclear.any()


def test_the_fixed_test_looks_at_the_last_interval_only(evidence_of: Measured) -> None:
    def blind(m: FloatArray) -> None:
        m[ROWS[-1], 0, 2:] = np.nan

    evidence = replace(evidence_of(car(0.0, 10.0, 2), wrong=blind), distance_m=np.array([9.0, 9.0]))
    verdict = fixed_test(evidence, SETTINGS)
    assert verdict.tested.tolist() == [False, True]
    assert verdict.moving.tolist() == [False, True]
