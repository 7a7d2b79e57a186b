"""Tracks of synthetic bodies: ids, life, velocities and their stated uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import object_fixtures
import pytest
from object_fixtures import FRAME_NS, NOISE, T_WORLD_CAM0, frame_of, small_rig, standing_window

from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import positions
from ovmot.geometry.so3 import rotation_z
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.objects import output
from ovmot.objects.body_birth import start_body
from ovmot.objects.feature_motions import FeatureHistory
from ovmot.objects.measurement import ObjectMeasurement
from ovmot.objects.tracker import ObjectTracker
from ovmot.physics import CAR_SIZE_M
from ovmot.settings import ObjectTrackSettings
from ovmot.types import ObjectTrack, PointLabel, ScenePoints

SIZE = np.array(CAR_SIZE_M)


@dataclass
class Body:
    """A box of points that goes straight or in a curve; `seen` says at which times it is."""

    start: FloatArray
    velocity: FloatArray
    first_id: int
    yaw_rate: float = 0.0
    stops_at_s: float = np.inf
    hidden_s: tuple[float, float] = (np.inf, np.inf)
    points: FloatArray = field(
        default_factory=lambda: np.random.default_rng(1).uniform(-0.5, 0.5, (12, 3)) * SIZE
    )

    def motion(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Position and velocity (3,) at t seconds; before it stops it brakes at 5 m/s²."""
        v = self.velocity
        if self.yaw_rate == 0.0:
            brakes_s = float(np.linalg.norm(v)) / 5.0
            late = np.clip(t - self.stops_at_s + brakes_s, 0.0, brakes_s)
            way = min(t, self.stops_at_s) - 0.5 * late**2 / brakes_s
            return self.start + v * way, v * (1.0 - late / brakes_s)
        a, w = self.yaw_rate * t, self.yaw_rate
        s, c = np.sin(a), np.cos(a)
        moved = np.array([[s, c - 1.0], [1.0 - c, s]]) @ v[:2] / w
        turned = np.array([[c, -s], [s, c]]) @ v[:2]
        return self.start + np.array([*moved, 0.0]), np.array([*turned, 0.0])

    def points_at(self, t: float) -> FloatArray:
        """Its points (n, 3) at t seconds."""
        heading = np.arctan2(self.velocity[1], self.velocity[0])
        turn = rotation_z(float(heading) + self.yaw_rate * t)
        return self.points @ turn.T + self.motion(t)[0]

    def is_seen(self, t: float) -> bool:
        return not self.hidden_s[0] <= t < self.hidden_s[1]

    @property
    def feature_id(self) -> IntArray:
        return self.first_id + np.arange(len(self.points))


def measure(
    body: Body, t: float, rng: np.random.Generator, sigma: float = 0.25
) -> ObjectMeasurement | None:
    """What the stage before gives: nothing of what stands or is hidden."""
    position, velocity = body.motion(t)
    if not body.is_seen(t) or np.linalg.norm(velocity) < 0.5:
        return None
    P = np.diag(np.repeat([0.05, sigma], 3) ** 2)
    e = rng.multivariate_normal(np.zeros(6), P)
    return ObjectMeasurement(
        feature_id=body.feature_id, p_world=body.points_at(t), position=position + e[:3],
        velocity=velocity + e[3:], T_now_before=np.eye(4), span_s=0.1, covariance=P,
        size=SIZE + rng.normal(0.0, 0.05),
    )  # fmt: skip


def scene_points(bodies: Sequence[Body], t: float, rng: np.random.Generator) -> ScenePoints:
    """What both cameras see of the bodies, to 0.3 px."""
    ids, world = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    for body in bodies:
        if body.is_seen(t):
            ids.append(body.feature_id)
            world.append(body.points_at(t))
    feature_id, p_world = np.concatenate(ids), np.concatenate(world)
    rig = small_rig()
    xy, _ = project_stereo(se3.apply(se3.inverse(T_WORLD_CAM0), p_world), rig.T_cam1_cam0)
    xy = xy + rng.normal(0.0, NOISE.sigma_px / rig.cam0.fx, xy.shape)
    p_cam0 = triangulate_stereo(xy, rig.T_cam1_cam0)
    left, right = rig.cam0.denormalize(xy[:, :2]), rig.cam1.denormalize(xy[:, 2:])
    points = object_fixtures.scene_points(
        [PointLabel.DYNAMIC] * len(feature_id), feature_id=feature_id, p_cam0=p_cam0,
        pixels=np.concatenate([left, right], axis=1),
    )  # fmt: skip
    return replace(
        points,
        cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, rig.normalized_sigma(NOISE.sigma_px)),
    )


class Stage:
    """The tracker with a rig that stands, and the last frames, from which bodies begin."""

    def __init__(self) -> None:
        self.tracker = ObjectTracker(small_rig(), ObjectTrackSettings())
        self.history = FeatureHistory()
        self._past: list[tuple[int, ScenePoints]] = []

    def step(
        self, now_ns: int, found: Sequence[ObjectMeasurement], points: ScenePoints
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        frame = frame_of(points, now_ns)
        window = standing_window(now_ns, 8)
        past = [(t, p) for t, p in self._past if t in set(window.timestamp_ns.tolist())]
        history = history_of(past, now_ns, points)
        self._past = [*past, (now_ns, points)]
        return self.tracker.step(
            frame, found, points, self.history.add(now_ns, points, T_WORLD_CAM0),
            lambda m, prior: start_body(
                m.feature_id, m.velocity, history, frame, window, small_rig(), prior
            ),
        )  # fmt: skip


def history_of(
    past: Sequence[tuple[int, ScenePoints]], now_ns: int, points: ScenePoints
) -> StereoHistory:
    """The earlier stereo pairs of the points."""
    n, rig = len(points.feature_id), small_rig()
    then, p_then = np.full((len(past), n, 4), np.nan), np.full((len(past), n, 3), np.nan)
    for row, (_, earlier) in enumerate(past):
        at = positions(points.feature_id, earlier.feature_id)
        then[row, at >= 0] = rig.normalize(earlier.pixels)[at[at >= 0]]
        p_then[row, at >= 0] = earlier.p_cam0[at[at >= 0]]
    stamps = np.array([t for t, _ in past], dtype=np.int64)
    return StereoHistory(
        points.feature_id, np.arange(len(past)), stamps,
        np.asarray(1e-9 * (now_ns - stamps), np.float64),
        np.arange(len(past), 0, -1), then, rig.normalize(points.pixels), p_then, points.p_cam0,
        points.cov_cam0, NOISE,
    )  # fmt: skip


def run(
    bodies: Sequence[Body], seconds: float, seed: int = 0, frame_ns: int = FRAME_NS
) -> list[tuple[float, tuple[ObjectTrack, ...], IntArray]]:
    rng = np.random.default_rng(seed)
    stage = Stage()
    out = []
    for k in range(round(1e9 * seconds / frame_ns)):
        t = 1e-9 * k * frame_ns
        found = [m for body in bodies if (m := measure(body, t, rng)) is not None]
        tracks, points = stage.step(k * frame_ns, found, scene_points(bodies, t, rng))
        out.append((t, tracks, points.track_id))
    return out


def without_right(points: ScenePoints) -> ScenePoints:
    pixels = points.pixels.copy()
    pixels[:, 2:] = np.nan
    return replace(points, pixels=pixels, p_cam0=np.full_like(points.p_cam0, np.nan))


def body(x: float, y: float, vx: float, vy: float, first_id: int = 0, **more: object) -> Body:
    made = Body(np.array([x, y, 0.8]), np.array([vx, vy, 0.0]), first_id)
    return replace(made, **more)  # type: ignore[arg-type]


def confirmed(tracks: tuple[ObjectTrack, ...]) -> list[ObjectTrack]:
    return [track for track in tracks if track.state == "confirmed"]


@pytest.mark.parametrize(
    "moving",
    [
        body(12.0, 0.0, 9.0, 0.0),  # a lead car
        body(50.0, 3.0, -18.0, 0.0),  # an oncoming one
        body(15.0, -12.0, 0.0, 7.0),  # a crossing one
        body(8.0, 3.0, 0.0, -1.2),  # a walker
        body(15.0, 0.0, 6.0, 0.0, yaw_rate=0.5),
    ],
    ids=["lead", "oncoming", "crossing", "walker", "turning"],
)
@pytest.mark.parametrize("frame_ns", [100_000_000, 50_000_000])
def test_one_body_is_one_track(moving: Body, frame_ns: int) -> None:
    frames = run([moving], 2.5, frame_ns=frame_ns)
    assert {track.track_id for _, tracks, _ in frames for track in tracks} == {0}
    for t, tracks, owner in frames:
        if t < 0.35:
            continue
        (track,) = confirmed(tracks)
        position, velocity = moving.motion(t)
        off = float(np.linalg.norm(track.velocity - velocity))
        assert off < max(0.9, 3.0 * float(np.linalg.norm(track.std_velocity)))
        sigma = float(np.linalg.norm(track.std_position))
        assert np.linalg.norm(track.position - position) < max(1.5, off, 3.0 * sigma)
        assert set(owner.tolist()) <= {0, -1}
        assert track.n_points == np.count_nonzero(owner == 0) >= 9  # outliers leave
        if np.linalg.norm(velocity) > 2.0:
            heading = np.arctan2(velocity[1], velocity[0])
            assert abs(np.angle(np.exp(1j * (track.yaw - heading)))) < 0.25
        u_min, v_min, u_max, v_max = track.box_px
        assert u_min < u_max and v_min < v_max


def test_a_turning_body_is_seen_to_turn() -> None:
    _, tracks, _ = run([body(15.0, 0.0, 6.0, 0.0, yaw_rate=0.5)], 3.0)[-1]
    assert tracks[0].yaw_rate == pytest.approx(0.5, abs=0.1)
    _, tracks, _ = run([body(15.0, 0.0, 6.0, 0.0)], 3.0)[-1]
    assert abs(tracks[0].yaw_rate) < min(3.0 * tracks[0].std_yaw_rate, 0.2)


def test_a_body_that_stops_stays_a_track() -> None:
    frames = run([body(10.0, 2.0, 5.0, 0.0, stops_at_s=1.5)], 4.0)
    assert {track.track_id for _, tracks, _ in frames for track in tracks} == {0}
    (last,) = frames[-1][1]
    assert last.state == "confirmed"
    assert np.linalg.norm(last.velocity) < 0.2
    assert np.linalg.norm(last.position - [15.0, 2.0, 0.8]) < 0.4


def test_an_occluded_body_keeps_its_id() -> None:
    hidden = body(10.0, -8.0, 0.5, 6.0, hidden_s=(1.0, 2.5))
    after = replace(hidden, first_id=100)  # what comes back has new features
    rng = np.random.default_rng(3)
    stage = Stage()
    states = []
    for k in range(40):
        t = 0.1 * k
        now = hidden if t < 2.0 else after
        measurement = measure(now, t, rng)
        found = [] if measurement is None else [measurement]
        tracks, _ = stage.step(k * FRAME_NS, found, scene_points([now], t, rng))
        assert {track.track_id for track in tracks} <= {0}
        states.append(tracks[0].state if tracks else "gone")
    coasts = states.index("coasting")
    assert 12 < coasts < 22  # it is known for a while where it is, though it is not seen
    assert states[coasts:24] == ["coasting"] * (24 - coasts)
    assert states[26:] == ["confirmed"] * 14


def test_out_of_the_picture_a_body_coasts_at_once() -> None:
    leaves = body(10.0, 2.0, 0.0, 8.0, hidden_s=(0.8, 9.0))  # y = 8.4 m: past the left edge
    states = [tracks[0].state for _, tracks, _ in run([leaves], 1.5) if tracks]
    assert states[6] == "confirmed"
    assert states[11:] == ["coasting"] * len(states[11:])


def test_the_box_of_an_unseen_body_ends_with_the_picture() -> None:
    leaves = body(10.0, 2.0, 0.0, 8.0, hidden_s=(0.3, 9.0))
    boxes = {round(t, 1): tracks[0].box_px for t, tracks, _ in run([leaves], 1.5) if tracks}
    middle = small_rig().cam0.project(np.array([[-6.0, 0.8, 10.0]]))[0]  # at 0.5 s
    u_min, v_min, u_max, v_max = boxes[0.5]
    assert u_min < middle[0] < u_max
    assert v_min < middle[1] < v_max
    assert boxes[0.7][0] == -0.5  # partly out of it
    assert np.isnan(boxes[1.4]).all()


def test_a_body_that_has_left_is_not_found_again_by_a_few_features() -> None:
    rng = np.random.default_rng(7)
    stage = Stage()
    leaves = body(10.0, 2.0, 0.0, 8.0)
    other = body(10.0, 16.0, 0.0, 6.5, 500)
    for k in range(22):
        measurement = measure(leaves, 0.1 * k, rng) if k < 8 else None
        if k == 21:
            seen_again = measure(other, 0.0, rng)
            measurement = None if seen_again is None else _few(seen_again)
        found = [] if measurement is None else [measurement]
        seen = [leaves] if k < 8 else [other] if k == 21 else []
        tracks, _ = stage.step(k * FRAME_NS, found, scene_points(seen, 0.1 * (k % 21), rng))
    assert [(track.track_id, track.state) for track in tracks] == [
        (0, "coasting"),
        (1, "tentative"),
    ]


def test_features_of_one_camera_go_on_with_a_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a measurement and without stereo: it goes behind what only the right camera sees."""
    rng = np.random.default_rng(5)
    monkeypatch.setattr(output, "_MISSED_S", -1.0)
    monkeypatch.setattr(output, "_KNOWN_SIGMA_M", 0.0)
    stage = Stage()
    walker = body(10.0, -2.0, 0.0, 1.5)
    for k in range(20):
        t = 0.1 * k
        points = scene_points([walker], t, rng)
        measurement = measure(walker, t, rng) if k < 10 else None
        if k >= 10:
            points = without_right(points)
        found = [] if measurement is None else [measurement]
        (track,), _ = stage.step(k * FRAME_NS, found, points)
    assert track.state == "confirmed"
    assert np.linalg.norm(track.velocity - [0.0, 1.5, 0.0]) < 0.4
    sigma = float(np.linalg.norm(track.std_position))
    assert np.linalg.norm(track.position - walker.motion(1.9)[0]) < 3.0 * sigma


def test_features_left_behind_do_not_stop_a_fast_body() -> None:
    rng = np.random.default_rng(6)
    stage = Stage()
    car = body(15.0, 0.0, 0.0, 5.0)
    for k in range(16):
        now = min(0.1 * k, 1.0)  # from then on its features stay where they are
        measurement = measure(car, now, rng) if k <= 10 else None
        found = [] if measurement is None else [measurement]
        points = scene_points([car], now, rng)
        (track,), _ = stage.step(k * FRAME_NS, found, points)
    assert track.velocity[1] > 4.0


def test_unseen_for_long_it_is_gone_and_its_id_never_comes_back() -> None:
    frames = run([body(10.0, -8.0, 0.5, 4.0, hidden_s=(1.0, 3.6))], 5.0)
    ids = [[track.track_id for track in tracks] for _, tracks, _ in frames]
    assert ids[28] == [0]
    assert ids[33] == []
    assert ids[-1] == [1]


def test_two_bodies_side_by_side_do_not_swap() -> None:
    two = [body(12.0, -1.7, 8.0, 0.0), body(12.5, 1.7, 8.3, 0.0, first_id=50)]
    frames = run(two, 3.0)
    for t, tracks, _ in frames[4:]:
        by_id = {track.track_id: track for track in confirmed(tracks)}
        assert set(by_id) == {0, 1}
        for k in (0, 1):
            assert np.linalg.norm(by_id[k].position - two[k].motion(t)[0]) < 0.6


def _few(measurement: ObjectMeasurement) -> ObjectMeasurement:
    return replace(measurement, feature_id=measurement.feature_id[:4])


def test_few_features_measured_once_are_never_confirmed() -> None:
    rng = np.random.default_rng(5)
    stage = Stage()
    for k in range(30):
        found, seen = [], []
        if k % 4 == 0:
            x, y, vx, vy = rng.uniform([8.0, -8.0, -6.0, -6.0], [30.0, 8.0, 6.0, 6.0])
            ghost = body(x, y, vx, vy, 20 * k)
            ghost_seen = measure(ghost, 0.0, rng)
            found, seen = [] if ghost_seen is None else [_few(ghost_seen)], [ghost]
        tracks, _ = stage.step(k * FRAME_NS, found, scene_points(seen, 0.0, rng))
        assert not confirmed(tracks)


def test_two_tracks_on_one_body_become_one() -> None:
    """For a while its halves are measured apart, each with its own features."""
    rng = np.random.default_rng(6)
    whole = body(12.0, 0.0, 8.0, 0.0)
    front = replace(whole, start=whole.start + np.array([1.0, 0.0, 0.0]), first_id=50)
    stage = Stage()
    counts = []
    for k in range(25):
        t = 0.1 * k
        halves = [whole, front] if k < 4 else [whole]
        found = [m for b in halves if (m := measure(b, t, rng)) is not None]
        tracks, _ = stage.step(k * FRAME_NS, found, scene_points(halves, t, rng))
        counts.append(len(tracks))
    assert max(counts) == 2
    assert counts[-1] == 1
    assert tracks[0].track_id == 0


def test_the_velocity_is_as_sure_as_it_says() -> None:
    nees = []
    for seed in range(20):
        moving = body(20.0, -6.0, 2.0, 5.0)
        for t, tracks, _ in run([moving], 2.0, seed=seed)[6:]:
            e = tracks[0].velocity - moving.motion(t)[1]
            nees.append(float((e**2 / tracks[0].std_velocity ** 2).sum()))
    assert 0.3 * 3.0 < np.mean(nees) < 2.0 * 3.0


def test_nothing_to_track() -> None:
    frames = run([], 0.5)
    assert all(tracks == () and len(owner) == 0 for _, tracks, owner in frames)
