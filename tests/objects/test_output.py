"""Output conversion: a track's fields, and the state that is reported."""

import numpy as np
import pytest
from object_fixtures import FRAME_NS, T_WORLD_CAM0, make_track, small_rig

from ovmot.objects.body_kernel import BodyState
from ovmot.objects.output import to_object_tracks
from ovmot.objects.track import Track, TrackState
from ovmot.types import ObjectTrack


def converted(track: Track, now_ns: int = FRAME_NS) -> ObjectTrack:
    pixels = np.array([[0.0, 1.0, 0.0, 1.0], [5.0, 70.0, 0.0, 0.0], [8.0, 9.0, 0.0, 0.0]])
    owner = np.array([1, -1, 1])
    other = make_track(track_id=3)
    tracks = [other, track]
    out = to_object_tracks(tracks, now_ns, pixels, owner, T_WORLD_CAM0, small_rig())
    assert [t.track_id for t in out] == [3, track.track_id]
    assert out[0].n_points == 0
    return out[1]


def test_fields_are_those_of_the_track() -> None:
    track = make_track((10.0, 1.0, 1.0), (3.0, 0.5, 0.0))
    out = converted(track)
    assert (out.track_id, out.state, out.n_points) == (7, "confirmed", 2)
    np.testing.assert_array_equal(out.position, track.position)
    np.testing.assert_array_equal(out.velocity, track.velocity)
    np.testing.assert_array_equal(out.box_px, [0.0, 1.0, 8.0, 9.0])
    variance = np.diag(track.covariance)
    np.testing.assert_allclose(out.std_velocity**2, variance[3:])
    np.testing.assert_array_equal(out.std_size, track.box.std_size)
    assert out.std_yaw == pytest.approx(np.sqrt(track.heading.variance))


def test_the_centre_is_half_as_uncertain_as_the_size() -> None:
    track = make_track((10.0, 1.0, 1.0), (3.0, 0.0, 0.0))
    box = track.box._replace(yaw=0.5 * np.pi, std_size=np.array([2.0, 0.4, 0.6]))
    out = converted(track._replace(box=box))
    added = out.std_position**2 - np.diag(track.covariance)[:3]
    np.testing.assert_allclose(added, [0.2**2, 1.0**2, 0.3**2], atol=1e-9)


def test_how_far_the_reported_centre_is_behind_is_in_its_sigma() -> None:
    track = make_track((10.0, 1.0, 1.0), (3.0, 0.0, 0.0))
    at_once, late = converted(track), converted(track._replace(lag=np.array([0.3, 0.0, -0.1])))
    np.testing.assert_allclose(late.position - at_once.position, [0.3, 0.0, -0.1])
    np.testing.assert_allclose(late.std_position**2 - at_once.std_position**2, [0.09, 0.0, 0.01])


@pytest.mark.parametrize(
    ("x", "sigma_m", "missed_s", "state"),
    [
        (10.0, 2.0, 0.1, "confirmed"),  # for a moment
        (10.0, 2.0, 0.4, "coasting"),
        (10.0, 0.1, 0.4, "confirmed"),  # occluded, but well known
        (-10.0, 0.1, 0.4, "coasting"),  # out of the image
    ],
)
def test_a_missed_track_stays_confirmed_while_it_is_known_in_view(
    x: float, sigma_m: float, missed_s: float, state: str
) -> None:
    track = make_track((x, 0.0, 1.0), state=TrackState.COASTING)
    before = track.body.state
    unsure = BodyState(before.x, before.f, sigma_m**2 * np.eye(len(before.P)))
    track = track._replace(body=track.body._replace(state=unsure))
    assert converted(track, FRAME_NS + round(1e9 * missed_s)).state == state
