"""What more than one stage must agree on: pixel noise, road users' motions and sizes, gates.

A number here is a fact with its source, or a stated standard deviation. Stages derive from it what
they need; none has a value of its own.
"""

from functools import lru_cache

import numpy as np
from scipy.special import chdtri, ndtri

from ovmot.geometry.arrays import FloatArray

UNIFORM_VARIANCE = 1.0 / 12.0
"""Of what is anywhere between 0 and 1."""
# Features in the image.
PIXEL_SIGMA = 0.4
"""Standard deviation of each pixel coordinate of a stereo match, pixels, before it is measured.

Of sub-pixel registration of patches by Lucas-Kanade on real images (S. Baker & I. Matthews, IJCV
2004, find some tenths of a pixel)."""
LENS_SIGMA_PX = 0.25
"""Of where a lens model puts a feature, common to those around it: good calibrations leave 0.1 to
0.3 pixel of reprojection error (P. Furgale et al., Kalibr; Z. Zhang, PAMI 2000: 0.3)."""
LENS_SCALE_SIGMA = 0.1
"""Of a lens model's scale, as a share, where polynomials go beyond the calibration's points: the
lamps in a corner of EuRoC's MH_01 are off by 0.16 of the way that a turn takes them."""
LEAST_MATCH_SIGMA_PX = 0.1
"""Standard deviation that least squares matching of natural texture reaches at best, a tenth of a
pixel (A. Gruen, "Adaptive least squares correlation", S. African J. of Photogrammetry 14, 1985)."""
PATCH_DRIFT_PX = 0.15
"""Standard deviation by which a tracked patch drifts on what it shows, pixels, from frame to frame:
a random walk."""
DEPTH_SLIDE_SHARE = 0.3
"""Probability that a patch's disparity slides as its neighbour's does: they lie on one occluding
edge, or on one texture that repeats itself."""
SLIDE_SHARE = 0.05
"""Probability that a patch lies on an edge between near and far, or along one, and slides with its
neighbours there."""
VARIANCE_FACTOR = 2.0
"""Errors of drifting patches persist from frame to frame. A covariance that takes them as
independent is too small by about this factor; gates on what many frames say are wider by it."""

# Stamps of frames.
FRAME_JITTER = 0.05
"""Frames are off their nominal spacing by up to this part of it."""

# Inertial sensors.
GYRO_BIAS_SIGMA_RPS = 0.05
"""Prior of a gyroscope's bias: 3 deg/s, the zero-rate offset in data sheets of MEMS units."""
MAX_ACCEL_BIAS_MPS2 = 1.5
"""Beyond the bias of any accelerometer: 0.15 g, the zero-g offset in data sheets of MEMS units."""

MEMS_NOISE = (1.7e-4, 2e-5, 2e-3, 3e-4)
"""Noise densities of a MEMS unit of the class of the Xsens MTi-300 or the ADIS16448, for data that
say none: gyro rad/s/√Hz, its walk rad/s²/√Hz, accel m/s²/√Hz, its walk m/s³/√Hz."""

# Road users. Sources: Directive 96/53/EC (greatest vehicle dimensions).
ACCEL_SIGMA_MPS2 = 1.5
"""Standard deviation of a road user's acceleration along and across its way in ordinary traffic."""
FULL_BRAKING_MPS2 = 8.0
"""Deceleration of a car that brakes fully: a friction of 0.8 on dry asphalt (T. Gillespie,
Fundamentals of Vehicle Dynamics, 1992, ch. 3) times gravity."""
TURN_SPREAD_MPS = 0.5
"""Velocities of points of one turning body differ by this: 0.4 rad/s at 1.25 m from its centre."""
ROAD_SPEED_SIGMA_MPS = (10.0, 10.0, 0.5)
"""Standard deviation of a road user's velocity in either level direction and upwards: 36 km/h, and
a slope of 5 % at that speed."""
ROAD_USER_AREA_M2 = 70.0
"""Road with one road user on it: on a lane of 3.5 m, two seconds apart at 36 km/h."""
MAX_SLOPE = 0.12
"""Of a street: the greatest grade of urban collectors in mountains, at 30 mph (AASHTO, A Policy on
Geometric Design of Highways and Streets, 6.3)."""
MANOEUVRE_S = 2.0
"""A road user keeps its acceleration and its yaw rate for about this long: their correlation time
(R. Singer, IEEE TAES 1970)."""
STEADY_S = 0.5 * MANOEUVRE_S
"""Over this a road user goes steadily enough to be measured by one velocity."""
YAW_RATE_SIGMA_RPS = 0.25
"""Standard deviation of a road user's yaw rate: the acceleration above across its way, at 6 m/s."""
LEAST_HEADWAY_S = 0.5
"""Vehicles that follow each other keep at least this time between them (M. Brackstone & M.
McDonald, Transportation Research F 2, 1999, on car following)."""
MAX_YAW_RATE_RPS = 2.0
"""Beyond what a body on a road turns by: 0.8 g at 4 m/s."""
CAR_SIZE_M = (4.5, 1.9, 1.5)
"""Length, width and height of a passenger car."""
CAR_CLEARANCE_M = 0.15
"""Between the road and a car's floor (ground clearances in data sheets are 0.12 to 0.2 m): what is
lower is its wheels, or its shadow."""
LORRY_SIZE_M = (8.0, 2.5, 3.3)
"""The same of a lorry of two axles."""
LEAST_HEIGHT_M = 0.3
"""Every road user rises higher than this: a car's bumper begins there (UN Regulation 42: 0.445 m is
the height of its test)."""
MAX_VEHICLE_SIZE_M = (18.75, 2.6, 4.0)
"""Greatest length, width and height of a vehicle on a road (Directive 96/53/EC)."""

WALKER_MPS, WALKER_SIGMA_MPS = 1.34, 0.26
"""Mean speed of walkers and its standard deviation (U. Weidmann, Transporttechnik der Fussgänger,
1993)."""
SLOW_MPS = 0.5
"""Half of the slowest walking (R. Bohannon, Age and Ageing 26, 1997: comfortable gait from 1.0)."""
CYCLIST_MPS, CYCLIST_SIGMA_MPS = 4.25, 1.2
"""Mean speed of cyclists on ordinary bicycles in town, 15.3 km/h (K. Schleinitz et al., Safety
Science 92, 2017), and its standard deviation."""
MAX_ROAD_MPS = (8.0, 14.0, 36.0)
"""Greatest speeds of walkers (who sprint), cyclists (50 km/h, downhill) and vehicles (130 km/h)."""
ODD_SPEED_SHARE = 0.05
"""Probability that a walker or cyclist goes at none of the usual speeds above."""
WALKER_SIZE_M = (0.75, 0.5, 1.72)
"""Length in mid-step, breadth of the shoulders and height of a person (step: Weidmann, 1993;
breadth and height: DIN 33402-2, mean of the medians)."""
WALKER_DEPTH_M = 0.28
"""Depth of a standing person (DIN 33402-2): what a walker's length is between two steps."""
CYCLIST_SIZE_M = (1.8, 0.6, 1.75)
"""Length of a bicycle, breadth of its handlebar, height of the rider on it (ISO 4210)."""
SIZE_SPREAD = 0.1
"""Standard deviation of a body's length, width and height within its class, as a share; of heights
of people it is 4 %, and clothes, bags and steps add to it."""
VEHICLE_SPREADS = (0.25, 0.15)
"""The same of lengths and heights of vehicles of one width: vans of 4.4 to 7 m, lorries of 6 to 12
m; saloons of 1.4 m, vans of 2 m and more."""
TRIP_SHARES = (0.22, 0.11, 0.43)
"""Of all trips, on foot, by bicycle and as the driver of a car (Mobilität in Deutschland, 2017)."""
CLASS_SIZES_M = (
    (0.5 * (WALKER_SIZE_M[0] + WALKER_DEPTH_M), *WALKER_SIZE_M[1:]), CYCLIST_SIZE_M, CAR_SIZE_M,
)  # fmt: skip
"""Sizes (length, width, height) of walkers, in the middle of their step, cyclists and cars."""
_STEP_SPREAD = (WALKER_SIZE_M[0] - WALKER_DEPTH_M) * UNIFORM_VARIANCE**0.5 / CLASS_SIZES_M[0][0]
CLASS_SIZE_SPREADS = (
    (_STEP_SPREAD, SIZE_SPREAD, SIZE_SPREAD),
    (SIZE_SPREAD, SIZE_SPREAD, SIZE_SPREAD),
    (VEHICLE_SPREADS[0], SIZE_SPREAD, VEHICLE_SPREADS[1]),
)
"""Their standard deviations, as shares; a walker's length is anywhere within its step."""
# A rig at rest on its springs or its tripod.
REST_SHIFT_M = 0.01
"""A body that rocks on its springs moves its camera by up to this."""
REST_STEP_M = 2e-3
"""The same from one frame to the next, standard deviation: a tenth of a second of it."""
REST_SPEED_MPS = 0.02
"""Its speed, standard deviation: `REST_STEP_M` in a tenth of a second."""
REST_TURN_RAD = 2e-4
"""Its rotation from one frame to the next, standard deviation: `REST_STEP_M` over ten metres."""


def tracked_pixel_sigma(n_frames: float, pixel_sigma: float = PIXEL_SIGMA) -> float:
    """Standard deviation, pixels, of a stereo match whose patch was tracked over `n_frames` frames.

    White noise, `pixel_sigma`, and drift: 0.7 px over 15 frames, the filter's window; 1.5 px over
    100 frames.
    """
    return float(np.sqrt(pixel_sigma**2 + n_frames * PATCH_DRIFT_PX**2))


def epipolar_pixel_sigma(
    distance_px: FloatArray, *, tails: float = 1.5, min_matches: int = 20
) -> float:
    """Standard deviation of each pixel of a stereo pair, by the distances (N,) of right points from
    their epipolar lines, pixels; NaN for few.

    A distance holds the noise of both pixels, and is all noise: what it shows across the line, the
    disparity has along it. Robust (1.4826 times the median, that of a normal distribution), at
    least what matching can reach (`LEAST_MATCH_SIGMA_PX`), and wider by `tails`: matches have
    heavier tails than their median shows.
    """
    n = len(distance_px)
    if n < min_matches:
        return float("nan")
    middle = [(n - 1) // 2, n // 2]
    median = 0.5 * sum(np.partition(distance_px, middle)[middle].tolist())
    return float(tails * max(1.4826 * median / 2.0**0.5, LEAST_MATCH_SIGMA_PX))


@lru_cache(maxsize=64)
def sigmas(probability: float) -> float:
    """Standard deviations that a Gaussian error stays below, on one side, with this probability."""
    return float(ndtri(probability))


SIGMAS_95 = sigmas(0.975)
"""Standard deviations within which, on both sides, a Gaussian error is with 95 %."""


@lru_cache(maxsize=4096)
def gate(dof: int, probability: float) -> float:
    """Squared Mahalanobis distance that a true measurement of `dof` degrees of freedom stays below
    with this probability: a quantile of the chi-squared distribution."""
    return float(chdtri(dof, 1.0 - probability))


@lru_cache(maxsize=256)
def gates(most_dof: int, probability: float) -> FloatArray:
    """The same for 0 to `most_dof` degrees of freedom (most_dof + 1,), that of 1 for 0."""
    dof = np.maximum(np.arange(most_dof + 1.0), 1.0)
    bounds = np.asarray(chdtri(dof, 1.0 - probability))
    bounds.flags.writeable = False
    return bounds


# The rig.
RIG_REACH_M = 3.0
"""What is nearer than this and stands still in the picture is the rig: the bonnet of a car before a
camera behind the windscreen or on the roof. Other vehicles do not keep such a distance."""
