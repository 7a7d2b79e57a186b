"""Random drives through a town: legs of straight road with stops and right-angled turns between."""

import numpy as np

from ovmot.sim.profiles import Road, SmoothSteps

_START_S, _CHANGE_S = 1.5, 4.0
_CRUISE_MPS, _CRUISE_S, _STAND_S = (6.0, 12.0), (3.0, 10.0), (2.0, 5.0)
_TURN_MPS, _TURN_CURVATURE = 4.0, 1.0 / 8.0
_TURN_M = 0.5 * np.pi / (0.75 * _TURN_CURVATURE)
"""Length of a turn by 90 degrees whose curvature rises and falls over a quarter of it each."""


def city_drive(
    duration_s: float, rng: np.random.Generator, *, stop_share: float = 0.5
) -> tuple[Road, SmoothSteps]:
    """A way and a speed for `drive_path`: it stands 1.5 s and then drives from leg to leg.

    A leg speeds up to 6 to 12 m/s and ends at a stop of 2 to 5 s, with probability `stop_share`,
    or in a turn by 90 degrees to either side at 4 m/s. The road may cross itself.
    """
    knots, bends = [(_START_S, 0.0)], [(0.0, 0.0)]
    time, arc, pace = _START_S, 0.0, 0.0
    while time < duration_s:
        cruise, stretch = rng.uniform(*_CRUISE_MPS), rng.uniform(*_CRUISE_S)
        knots += [(time + _CHANGE_S, cruise), (time + _CHANGE_S + stretch, cruise)]
        arc += 0.5 * (pace + cruise) * _CHANGE_S + cruise * stretch
        time += stretch + 2.0 * _CHANGE_S
        pace = 0.0 if rng.uniform() < stop_share else _TURN_MPS
        arc += 0.5 * (cruise + pace) * _CHANGE_S
        knots.append((time, pace))
        if pace > 0.0:
            curvature = float(rng.choice([-1.0, 1.0])) * _TURN_CURVATURE
            corner = ((0.0, 0.0), (0.25, curvature), (0.75, curvature), (1.0, 0.0))
            bends += [(arc + share * _TURN_M, value) for share, value in corner]
            arc += _TURN_M
            time += _TURN_M / _TURN_MPS
        else:
            time += rng.uniform(*_STAND_S)
        knots.append((time, pace))
    return Road(SmoothSteps.make(*bends), arc), SmoothSteps.make(*knots)
