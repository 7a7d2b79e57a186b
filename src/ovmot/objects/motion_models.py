"""The state of a body and how it may change; `filter_kernel` holds the motion models.

State (7,): position x, y, z; velocity x, y, z; yaw rate about the vertical; in world, SI.
"""

from dataclasses import dataclass

from ovmot.physics import ACCEL_SIGMA_MPS2

POSITION, VELOCITY, YAW_RATE = slice(0, 3), slice(3, 6), 6


@dataclass(frozen=True, slots=True)
class Agility:
    """Process noise densities: accelerations along the ground and upwards in m/s²/√Hz, the yaw
    acceleration in rad/s²/√Hz."""

    accel: float
    lift: float
    yaw_accel: float


ROAD_USER_AGILITY = Agility(accel=ACCEL_SIGMA_MPS2, lift=0.2, yaw_accel=0.3)
"""White acceleration that gives a road user's standard deviation after one second."""
