"""Recorded poses become a motion that a body can make, in their own place or moved."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.pose_files import interpolate_poses, read_tum, write_tum
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray
from ovmot.geometry.so3 import rotation_z
from ovmot.sim.paths import MARGIN_S
from ovmot.sim.recorded_paths import placement_at, recorded_path, rms_acceleration

ORIGIN = 1_500_000_000_000_000_000
RECORDED = 1_400_000_000_123_456_789
MARGIN_NS = round(1e9 * MARGIN_S)


def bend(seconds: AnyArray) -> FloatArray:
    """Poses (N, 4, 4) of a body that goes round a circle of 5 m at 1 m/s, rising slowly."""
    yaw = 0.2 * seconds
    p = np.stack([5.0 * np.sin(yaw), 5.0 - 5.0 * np.cos(yaw), 0.1 * seconds], axis=-1)
    return se3.make(rotation_z(yaw) @ so3.exp(np.array([2.0, 0.3, -0.5])), p)


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., Path]:
    def write(seconds: FloatArray, noise_m: float = 0.0) -> Path:
        poses = bend(seconds)
        poses[:, :3, 3] += np.random.default_rng(0).normal(0.0, noise_m, (len(seconds), 3))
        stamps: IntArray = RECORDED + np.round(1e9 * seconds).astype(np.int64)
        write_tum(tmp_path / "path.txt", stamps, poses)
        return tmp_path / "path.txt"

    return write


def uneven(duration_s: float) -> FloatArray:
    steps = np.random.default_rng(1).uniform(0.03, 0.07, round(duration_s / 0.05))
    return np.concatenate([[0.0], np.cumsum(steps)])


def test_follows_the_recording_in_time_and_place(record: Callable[..., Path]) -> None:
    path = recorded_path(record(uneven(20.0)), ORIGIN, start_s=2.0, duration_s=10.0)
    assert path.start_ns <= ORIGIN - MARGIN_NS
    assert path.end_ns >= ORIGIN + 10 * 10**9 + MARGIN_NS
    since = 0.1 * np.arange(101)
    times = ORIGIN + np.round(1e9 * since).astype(np.int64)
    np.testing.assert_allclose(path.pose(times), bend(since + 2.0 + MARGIN_S), atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(path.velocity(times)[:, :2], axis=1), 1.0, atol=2e-3)


def test_noise_is_smoothed_until_the_acceleration_is_plausible(
    record: Callable[..., Path],
) -> None:
    recording = record(0.05 * np.arange(600), noise_m=0.05)
    raw = recorded_path(recording, ORIGIN, cutoff_hz=8.0)
    path = recorded_path(recording, ORIGIN)
    assert rms_acceleration(raw) > 20.0
    assert rms_acceleration(path) < 4.0
    times = np.linspace(ORIGIN, ORIGIN + 20 * 10**9, 200).astype(np.int64)
    true = bend(1e-9 * (times - ORIGIN) + MARGIN_S)
    np.testing.assert_allclose(path.pose(times)[:, :3, 3], true[:, :3, 3], atol=0.1)


def test_a_hole_is_refused_or_bridged(record: Callable[..., Path]) -> None:
    seconds = 0.05 * np.arange(400)
    recording = record(seconds[(seconds < 8.0) | (seconds > 9.2)])
    with pytest.raises(InputError, match=r"path.txt: no pose for 1.25\d* s, 7.95 s after"):
        recorded_path(recording, ORIGIN)
    clear = recorded_path(recording, ORIGIN, start_s=10.0)
    np.testing.assert_allclose(clear.pose(ORIGIN), bend(np.array(10.0 + MARGIN_S)), atol=1e-4)
    bridged = recorded_path(recording, ORIGIN, max_gap_s=2.0)
    inside = ORIGIN + round(1e9 * (8.6 - MARGIN_S))
    np.testing.assert_allclose(bridged.pose(inside), bend(np.array(8.6)), atol=2e-3)


@pytest.mark.parametrize(
    ("start_s", "duration_s", "message"),
    [
        (19.0, None, "is not in it"),
        (-1.0, None, "is not in it"),
        (0.0, 18.5, "18.5 s long is not in it"),
        (0.0, -1.0, "is not in it"),
    ],
)
def test_refuses_pieces_that_are_not_there(
    record: Callable[..., Path], start_s: float, duration_s: float | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        recorded_path(record(0.05 * np.arange(401)), ORIGIN, start_s=start_s, duration_s=duration_s)


def test_refuses_what_no_smoothing_makes_a_motion(record: Callable[..., Path]) -> None:
    with pytest.raises(InputError, match="even when smoothed"):
        recorded_path(record(0.05 * np.arange(400), noise_m=20.0), ORIGIN)


def test_placed_in_a_scene_it_keeps_tilt_and_height(record: Callable[..., Path]) -> None:
    recording = record(uneven(20.0))
    original = recorded_path(recording, ORIGIN)
    axis = np.array([0.0, 0.0, 1.0])
    T_scene_recorded = placement_at(original, ORIGIN, (3.0, -2.0), 0.7, axis)
    moved = recorded_path(recording, ORIGIN, T_scene_recorded=T_scene_recorded)
    T, T_original = moved.pose(ORIGIN), original.pose(ORIGIN)
    np.testing.assert_allclose(T[:3, 3], [3.0, -2.0, T_original[2, 3]], atol=1e-9)
    ahead = T[:3, :3] @ axis
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.7)
    np.testing.assert_allclose(T[2, :3], T_original[2, :3], atol=1e-9)  # the vertical in the body
    later = ORIGIN + 5 * 10**9
    np.testing.assert_allclose(
        moved.angular_velocity(later), original.angular_velocity(later), atol=1e-6
    )
    tilted = se3.make(so3.exp(np.array([0.1, 0.0, 0.0])), np.zeros(3))
    with pytest.raises(ValueError, match="vertical"):
        recorded_path(recording, ORIGIN, T_scene_recorded=tilted)


@pytest.mark.parametrize("name", ["tum_corridor1_512_16_okvis", "udel_gore"])
def test_real_recordings(data_root: Path, name: str) -> None:
    """Walks: metres a second squared as of a person, and never far from the recorded poses."""
    recording = data_root / "sim_paths" / f"{name}.txt"
    if not recording.exists():
        pytest.skip(f"{recording} is missing")
    path = recorded_path(recording, ORIGIN)
    assert 1.0 < rms_acceleration(path) < 4.0
    times = np.arange(ORIGIN, path.end_ns - MARGIN_NS, 73_000_000, dtype=np.int64)
    truth = read_tum(recording)
    shift = truth.timestamp_ns[0] + MARGIN_NS - ORIGIN
    known = interpolate_poses(truth, times + shift)
    reached = path.pose(times)
    assert np.linalg.norm(reached[:, :3, 3] - known[:, :3, 3], axis=-1).max() < 0.02
    turned = so3.log(np.swapaxes(known[:, :3, :3], 1, 2) @ reached[:, :3, :3])
    assert np.degrees(np.linalg.norm(turned, axis=-1)).max() < 1.0
