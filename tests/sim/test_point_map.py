"""What the map lists as near is what a look at all its points finds near."""

import numpy as np

from ovmot.sim.point_map import PointMap


def test_near_points_are_those_of_an_exhaustive_search() -> None:
    rng = np.random.default_rng(1)
    point_map, radius = PointMap(8.0), 8.0
    everything = np.empty((0, 3))
    for k in range(300):  # out along a winding way, and back over it
        s = 0.5 * (k if k < 150 else 300 - k)
        place = np.array([s, 5.0 * np.sin(0.2 * s), 0.0])
        index, points = point_map.near(place)
        np.testing.assert_array_equal(points, everything[index])
        assert np.all(np.diff(index) > 0)
        truly_near = np.flatnonzero(np.linalg.norm(everything - place, axis=1) <= radius)
        assert np.isin(truly_near, index).all()
        assert np.linalg.norm(points - place, axis=1).max(initial=0.0) < radius + 4.0 or k < 5
        if k % 3 == 0:
            new = place + rng.uniform(-4.0, 4.0, (rng.integers(0, 6), 3))
            point_map.add(new)
            everything = np.concatenate([everything, new])
    assert len(everything) > 200
    assert len(index) < 0.5 * len(everything)
