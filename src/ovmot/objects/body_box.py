"""The box of a body: the hull of its map along its heading, and what was never seen of it."""

import numpy as np

from ovmot.geometry.arrays import FloatArray
from ovmot.objects.body_box_kernel import (
    Box,
    Heading,
    Headings,
    Sizes,
    box_of_body_compiled,
    carried_box_compiled,
    steady_box_compiled,
    turned_heading_compiled,
)
from ovmot.objects.body_step_kernel import Body
from ovmot.physics import (
    CAR_CLEARANCE_M,
    CLASS_SIZE_SPREADS,
    CLASS_SIZES_M,
    LORRY_SIZE_M,
    MAX_VEHICLE_SIZE_M,
    SIGMAS_95,
    WALKER_DEPTH_M,
    WALKER_MPS,
    WALKER_SIGMA_MPS,
)

_SIZES = Sizes(
    usual=np.array(CLASS_SIZES_M),
    spread=np.array(CLASS_SIZE_SPREADS),
    lorry=np.array(LORRY_SIZE_M),
    greatest=np.array(MAX_VEHICLE_SIZE_M),
    vehicle_m=1.2,
    far=SIGMAS_95,
    least=WALKER_DEPTH_M,
    shadow=CAR_CLEARANCE_M,
)
_HEADINGS = Headings(
    wander=0.03,
    told=0.3,
    grazing=0.5,  # of 30 degrees: flatter, a side shows no texture that could be followed
    drives_mps=WALKER_MPS + 4.0 * WALKER_SIGMA_MPS,
)
GAP_M = 2.5
"""Without features, between two ends of a vehicle: as much as a lorry's axles are apart."""
REACH_M = 0.5
"""The same for who walks."""


def gap_of(box: Box) -> float:
    """Without features, between two parts of the body, at most, m."""
    return GAP_M if box.is_vehicle else REACH_M


def new_heading() -> Heading:
    """That of a body's birth: its frame lies along its velocity."""
    return Heading(0.0, np.pi**2, np.zeros(2, np.bool_), False)


def updated_heading(
    heading: Heading, body: Body, centre: FloatArray, camera: FloatArray, whole: bool,
    has_front: bool, dt: float,
) -> Heading:  # fmt: skip
    """The heading after dt seconds, by the body's velocity, and the sides that a `camera` (3,)
    sees of its `centre` (3,) if it is `whole` in view. What `has_front`, a vehicle, may reverse."""
    return turned_heading_compiled(heading, body, centre, camera, whole, has_front, dt, _HEADINGS)


def box_of(
    body: Body, kind: int, heading: Heading, least: FloatArray, camera: FloatArray
) -> Box:  # fmt: skip
    """The box of a body of a `kind`, of `motion_class.py: CLASSES`, seen by a `camera` (3,), of at
    least the size `least` (3,).

    What was not seen of it is as large as is usual, behind what was. What lies farther from the
    rest than a lorry is long is not of this body.
    """
    return box_of_body_compiled(body, kind, heading, least, camera, LORRY_SIZE_M[0], _SIZES)


def steady_box(
    body: Body, kind: int, before: Body, heading: Heading, old: Box, least: FloatArray,
    camera: FloatArray, gain: float,
) -> Box:  # fmt: skip
    """The box of a body, which changes by a `gain` from the `old` one of the body `before`."""
    return steady_box_compiled(
        body, kind, before.state.x, heading, old, least, camera, gain, LORRY_SIZE_M[0], _SIZES
    )


def carried_box(body: Body, before: Body, box: Box) -> Box:
    """The box of a body that was not seen since it was as `before`: it goes with it."""
    return carried_box_compiled(body, before.state.x, box)
