"""Distances of all tracks to all measurements at once are those of one filter and one of them."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.config import ObjectTrackSettings
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.object_filter import Observation, distance
from ovmot.objects.track import DRIVES_MPS, as_observation, carried, gaps, start_track


def measurement(seed: int, speed: float) -> ObjectMeasurement:
    rng = np.random.default_rng(seed)
    L = 0.1 * rng.normal(0.0, 1.0, (6, 6))
    position = rng.normal(0.0, 3.0, 3)
    return ObjectMeasurement(
        feature_id=np.array([7, 3, 5]), p_world=position + np.eye(3), position=position,
        velocity=np.array([speed, 0.5, 0.1]), yaw_rate=0.1, T_now_before=np.eye(4), span_s=0.4,
        covariance=L @ L.T + 0.01 * np.eye(6), yaw_rate_variance=0.01,
        size=rng.uniform(0.5, 2.0, 3),
    )  # fmt: skip


def test_gaps_are_the_distances_of_single_filters() -> None:
    now_ns = 200_000_000
    tracks = [
        carried(start_track(k, 0, measurement(k, v)), now_ns, ObjectTrackSettings())
        for k, v in enumerate((1.0, 8.0, DRIVES_MPS + 0.5))
    ]
    seen = [measurement(10, 8.2), replace(measurement(11, 1.0), span_s=0.1)]
    found = gaps(tracks, seen, now_ns)
    for i, track in enumerate(tracks):
        for j, m in enumerate(seen):
            size = np.maximum(track.size, m.size)
            whole = as_observation(m, size, 0.2)
            R = whole.covariance[:6, :6].copy()
            if np.hypot(*track.velocity[:2]) > DRIVES_MPS:  # its other end may be seen
                along = track.velocity / np.hypot(*track.velocity[:2])
                R[:3, :3] += (0.25 * (4.5 - size[0])) ** 2 * np.outer(along, along)
            six = Observation(whole.H[:6], whole.value[:6], R)
            assert found[i, j] == pytest.approx(distance(track.filter, six), rel=1e-9)
