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
from ovmot.objects.motion_class import CLASSES
from ovmot.physics import (
    CAR_SIZE_M,
    CYCLIST_SIZE_M,
    LORRY_SIZE_M,
    WALKER_DEPTH_M,
    WALKER_SIZE_M,
)

WALKER, CYCLIST, VEHICLE = (CLASSES.index(name) for name in ("walker", "cyclist", "vehicle"))

CAMERA = np.array([-15.0, 0.0, 1.0])
NOTHING = np.zeros(3)
SEEN = Heading(0.0, 0.01, np.array([True, True]), True)
FROM_BEHIND = SEEN._replace(shown=np.array([False, True]))


def box_size(
    body: Body, heading: Heading = SEEN, least: FloatArray = NOTHING, kind: int = VEHICLE
) -> list[float]:
    size: list[float] = np.round(box_of(body, kind, heading, least, CAMERA).size, 3).tolist()
    return size


def body_of_features(size: FloatArray, n: int, seed: int) -> Body:
    """A body with n features anywhere in its box."""
    body = make_body(ids=range(n - 8))
    f = np.random.default_rng(seed).uniform(-0.5, 0.5, (n, 3)) * size
    return body._replace(map=body.map._replace(f=f))


def test_the_box_is_around_what_was_seen() -> None:
    size = np.array([5.0, 1.7, 1.4])
    box = box_of(make_body((1.0, 2.0, 3.0), size=size), VEHICLE, SEEN, NOTHING, CAMERA)
    assert np.all(box.size > size - 1e-3)
    assert np.all(box.size - size < 2.0 * box.std_size)
    np.testing.assert_allclose(box.centre, [1.0, 2.0, 3.0], atol=1e-3)
    np.testing.assert_allclose(box.shown.extent, size, atol=1e-3)
    assert box_size(make_body(size=size), least=np.array([6.0, 1.0, 1.0]))[0] == 6.0


@pytest.mark.parametrize("n", [9, 20, 60])
@pytest.mark.parametrize(
    ("size", "kind"), [((4.2, 1.8, 1.45), VEHICLE), ((1.75, 0.6, 1.7), CYCLIST)]
)
def test_the_stated_sigma_of_the_size_is_that_of_its_errors(
    size: tuple[float, float, float], kind: int, n: int
) -> None:
    """Features anywhere on a body span less than it, by as much as order statistics say."""
    true, errors = np.array(size), []
    for seed in range(60):
        box = box_of(body_of_features(true, n, seed), kind, SEEN, NOTHING, CAMERA)
        errors.append((box.size - true) / box.std_size)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 1.0)
    assert np.all(np.mean(np.square(errors), axis=0) < 2.0)


def test_of_a_side_that_is_mostly_hidden_the_usual_size_is_taken() -> None:
    body = body_of_features(np.array([1.0, 1.8, 1.4]), 30, 0)
    box = box_of(body, VEHICLE, SEEN, NOTHING, CAMERA)
    assert box.size[0] == pytest.approx(CAR_SIZE_M[0], abs=0.01)
    assert box.std_size[0] > 1.0


def test_what_lies_far_behind_a_body_is_not_of_it() -> None:
    size = np.array([5.0, 1.7, 1.4])
    body = make_body(size=size)
    f = body.map.f.copy()
    f[0] = [30.0, 0.0, 0.0]
    mixed = body._replace(map=body.map._replace(f=f))
    assert box_of(mixed, VEHICLE, SEEN, NOTHING, CAMERA).shown.extent[0] == pytest.approx(
        5.0, abs=0.1
    )
    # a point so uncertain that it may lie on the body stays
    cov = body.map.cov.copy()
    cov[0] = 100.0 * np.eye(3)
    vague = body._replace(map=body.map._replace(f=f, cov=cov))
    assert box_of(vague, VEHICLE, SEEN, NOTHING, CAMERA).shown.extent[0] > 5.1


def test_of_a_car_seen_from_behind_the_length_is_the_usual_one() -> None:
    body = make_body((10.0, 0.0, 1.0), size=np.array([0.5, 1.7, 1.4]))
    box = box_of(body, VEHICLE, FROM_BEHIND, NOTHING, CAMERA)
    assert box.size[0] == CAR_SIZE_M[0]
    assert not box.shown.faces[0]
    rear = box.centre[0] - 0.5 * box.size[0]  # the face that was seen stays where it is
    assert rear == pytest.approx(10.0 - 0.25, abs=1e-3)
    assert box.std_size[0] > 2.0 * box.std_size[1]
    lorry = make_body(size=np.array([0.5, *LORRY_SIZE_M[1:]]))
    assert box_size(lorry, FROM_BEHIND)[0] == pytest.approx(LORRY_SIZE_M[0], abs=1e-3)
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
    box = box_of(outline, VEHICLE, SEEN, NOTHING, CAMERA)
    np.testing.assert_allclose(box.shown.extent[:2], [4.0, 1.7], atol=0.01)


def test_the_usual_size_is_that_of_the_class() -> None:
    walks = Heading(0.0, 0.01, np.array([False, False]), False)
    walker = box_size(make_body(size=np.array([0.3, 0.45, 1.6])), walks, kind=WALKER)
    assert WALKER_DEPTH_M < walker[0] < WALKER_SIZE_M[0]
    cyclist = box_size(make_body(size=np.array([0.3, 0.45, 1.6])), walks, kind=CYCLIST)
    assert cyclist[:2] == list(CYCLIST_SIZE_M[:2])


def test_noise_does_not_make_a_box_longer() -> None:
    rng = np.random.default_rng(1)
    body = make_body(ids=range(60), size=CAR_M)
    of_map = body.map
    noise = rng.normal(0.0, 1.0, (len(of_map.f), 3)) * [0.5, 0.0, 0.0]
    cov = np.broadcast_to(np.diag([0.25, 1e-12, 1e-12]), of_map.cov.shape).copy()
    noisy = body._replace(map=of_map._replace(f=of_map.f + noise, cov=cov))
    assert box_of(noisy, VEHICLE, SEEN, NOTHING, CAMERA).shown.extent[0] < CAR_M[0] + 0.5


def test_the_heading_is_the_direction_of_the_velocity_and_stays_at_rest() -> None:
    body = make_body(velocity=(3.0, 0.0, 0.0))
    body.state.x[4:6] = 3.0 * np.array([np.cos(0.3), np.sin(0.3)])
    heading = new_heading()
    for _ in range(40):
        heading = updated_heading(heading, body, NOTHING, CAMERA, True, True, 0.1)
    assert heading.angle == pytest.approx(0.3, abs=0.02)
    assert heading.drives
    assert heading.shown.tolist() == [False, True]
    reverses = make_body(velocity=(3.0, 0.0, 0.0))
    reverses.state.x[4:6] = -2.0 * np.array([np.cos(0.3), np.sin(0.3)])
    back = updated_heading(heading, reverses, NOTHING, CAMERA, True, True, 0.1)
    assert back.angle == pytest.approx(heading.angle, abs=0.02)
    stands = make_body(velocity=(0.0, 0.0, 0.0))
    assert updated_heading(heading, stands, NOTHING, CAMERA, True, True, 0.1).angle == heading.angle
    aside_of = np.array([0.0, 40.0, 0.0])
    cut = updated_heading(heading, body, aside_of, CAMERA, False, True, 0.1)
    assert not cut.shown.all()  # by the border of the image
    aside = updated_heading(heading, body, aside_of, CAMERA, True, True, 0.1)
    assert aside.shown.all()
