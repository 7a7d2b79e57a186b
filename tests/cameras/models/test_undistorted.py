"""The camera without distortion."""

import numpy as np

from ovmot.cameras.models import CAMERA_MODELS


def test_points_stay_where_they_are() -> None:
    model, nothing = CAMERA_MODELS["none"], np.empty(0)
    xy = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 5, 2))
    np.testing.assert_array_equal(model.distort(xy, nothing), xy)
    np.testing.assert_array_equal(model.undistort(xy, nothing), xy)
    J, C = model.distort_jacobian(xy, nothing)
    np.testing.assert_array_equal(J, np.broadcast_to(np.eye(2), (2, 5, 2, 2)))
    assert C.shape == (2, 5, 2, 0)
