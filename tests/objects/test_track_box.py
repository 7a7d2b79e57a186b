"""The box of a track in the image."""

import numpy as np
import pytest
from object_fixtures import T_WORLD_CAM0, make_track, small_rig

from ovmot.objects.track_box import is_in_view, projected_box


@pytest.mark.parametrize(("y", "seen"), [(0.0, True), (9.0, False)])
def test_the_centre_is_in_view_or_not(y: float, seen: bool) -> None:
    track = make_track((10.0, y, 1.0))
    assert is_in_view(track, T_WORLD_CAM0, small_rig()) is seen
    assert not is_in_view(make_track((-10.0, y, 1.0)), T_WORLD_CAM0, small_rig())


def test_the_image_box_is_that_of_the_corners() -> None:
    rig, track = small_rig(), make_track((10.0, 0.0, 1.6))
    length, width, height = track.size
    half = 400.0 / (10.0 - 0.5 * length) * np.array([0.5 * width, 0.5 * height])
    middle = np.array([320.0, 140.0])
    expected = np.concatenate([middle - half, middle + half])
    np.testing.assert_allclose(projected_box(track, T_WORLD_CAM0, rig), expected, atol=1e-3)
    gone = make_track((10.0, 20.0, 1.6))
    assert np.isnan(projected_box(gone, T_WORLD_CAM0, rig)).all()
