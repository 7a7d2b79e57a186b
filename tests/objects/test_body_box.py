"""The box of a body: the hull of its map, its heading, and what was not seen."""

import numpy as np
import pytest
from object_fixtures import CAR_M, make_body

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_box import (
    box_of,
    new_heading,
    updated_heading,
)
from ovmot.objects.body_box_kernel import Heading
from ovmot.objects.body_step_kernel import Body
from ovmot.physics import CAR_SIZE_M, LORRY_SIZE_M

CAMERA = np.array([-15.0, 0.0, 1.0])
NOTHING = np.zeros(3)
SEEN = Heading(0.0, 0.01, np.array([True, True]), True)
FROM_BEHIND = SEEN._replace(shown=np.array([False, True]))


def box_size(body: Body, heading: Heading = SEEN, least: FloatArray = NOTHING) -> list[float]:
    size: list[float] = np.round(box_of(body, heading, least, CAMERA).size, 3).tolist()
    return size


def test_the_box_is_the_hull_of_what_was_seen() -> None:
    size = np.array([5.0, 1.7, 1.4])
    box = box_of(make_body((1.0, 2.0, 3.0), size=size), SEEN, NOTHING, CAMERA)
    np.testing.assert_allclose(box.size, size, atol=1e-3)
    np.testing.assert_allclose(box.centre, [1.0, 2.0, 3.0], atol=1e-3)
    assert box_size(make_body(size=size), least=np.array([6.0, 1.0, 1.0])) == [6.0, 1.7, 1.4]


def test_what_lies_far_behind_a_body_is_not_of_it() -> None:
    size = np.array([5.0, 1.7, 1.4])
    body = make_body(size=size)
    f = body.map.f.copy()
    f[0] = [30.0, 0.0, 0.0]
    mixed = body._replace(map=body.map._replace(f=f))
    assert box_of(mixed, SEEN, NOTHING, CAMERA).size[0] == pytest.approx(5.0, abs=0.1)
    # a point so uncertain that it may lie on the body stays
    cov = body.map.cov.copy()
    cov[0] = 100.0 * np.eye(3)
    vague = body._replace(map=body.map._replace(f=f, cov=cov))
    assert box_of(vague, SEEN, NOTHING, CAMERA).size[0] > 5.1


def test_of_a_car_seen_from_behind_the_length_is_the_usual_one() -> None:
    body = make_body((10.0, 0.0, 1.0), size=np.array([0.5, 1.7, 1.4]))
    box = box_of(body, FROM_BEHIND, NOTHING, CAMERA)
    np.testing.assert_allclose(box.size, [CAR_SIZE_M[0], 1.7, 1.4], atol=1e-3)
    rear = box.centre[0] - 0.5 * box.size[0]  # the face that was seen stays where it is
    assert rear == pytest.approx(10.0 - 0.25, abs=1e-3)
    assert box.std_size[0] > 2.0 * box.std_size[1]
    lorry = make_body(size=np.array([0.5, *LORRY_SIZE_M[1:]]))
    assert box_size(lorry, FROM_BEHIND)[0] == LORRY_SIZE_M[0]
    van = make_body(size=np.array([0.5, 1.9, 2.4]))
    assert CAR_SIZE_M[0] + 1.0 < box_size(van, FROM_BEHIND)[0] < LORRY_SIZE_M[0] - 1.0


def test_a_shadow_on_the_road_is_no_side_of_a_body() -> None:
    """It moves as the body does, and reaches farther."""
    body = make_body(ids=range(12), size=np.array([4.0, 1.7, 1.4]))
    m = body.map
    f = np.concatenate([m.f, [[1.0, 2.5, -0.8], [-1.0, 2.5, -0.8]]])
    outline = body._replace(
        map=m._replace(
            feature_id=np.arange(14), f=f, cov=np.concatenate([m.cov, m.cov[:2]]),
            n_seen=np.full(14, 9), failures=np.zeros(14, np.int64),
            followed=np.ones(14, np.bool_), outline=np.ones(14, np.bool_),
        )
    )  # fmt: skip
    np.testing.assert_allclose(box_size(outline)[:2], [4.0, 1.7], atol=0.01)


def test_who_walks_has_no_hidden_side() -> None:
    walker = make_body(size=np.array([0.4, 0.5, 1.7]))
    walks = Heading(0.0, 0.01, np.array([False, True]), False)
    assert box_size(walker, walks) == [0.4, 0.5, 1.7]


def test_noise_does_not_make_a_box_longer() -> None:
    rng = np.random.default_rng(1)
    body = make_body(ids=range(60), size=CAR_M)
    of_map = body.map
    noise = rng.normal(0.0, 1.0, (len(of_map.f), 3)) * [0.5, 0.0, 0.0]
    cov = np.broadcast_to(np.diag([0.25, 1e-12, 1e-12]), of_map.cov.shape).copy()
    noisy = body._replace(map=of_map._replace(f=of_map.f + noise, cov=cov))
    assert box_size(noisy)[0] < CAR_M[0] + 0.5


def test_the_heading_is_the_direction_of_the_velocity_and_stays_at_rest() -> None:
    body = make_body(velocity=(3.0, 0.0, 0.0))
    body.state.x[4:6] = 3.0 * np.array([np.cos(0.3), np.sin(0.3)])
    heading = new_heading()
    for _ in range(40):
        heading = updated_heading(heading, body, NOTHING, CAMERA, 0.1)
    assert heading.angle == pytest.approx(0.3, abs=0.02)
    assert heading.drives
    assert heading.shown.tolist() == [False, True]
    stands = make_body(velocity=(0.0, 0.0, 0.0))
    assert updated_heading(heading, stands, NOTHING, CAMERA, 0.1).angle == heading.angle
    aside = updated_heading(heading, body, np.array([0.0, 40.0, 0.0]), CAMERA, 0.1)
    assert aside.shown.all()
