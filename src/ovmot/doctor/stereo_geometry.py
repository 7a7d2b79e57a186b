"""Checks of the stereo calibration against the matches that the images give.

A calibration explains a match if the right point lies near the left one's epipolar line, and on the
side of infinity where points in front of both cameras are. Mistakes of the usual kinds are tried as
other calibrations; the one that explains the matches is named.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ovmot.cameras.camera import Camera
from ovmot.cameras.models import CAMERA_MODELS
from ovmot.cameras.rig import StereoRig
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Finding, Severity
from ovmot.errors import CalibrationError
from ovmot.frontend.epipolar import epipolar_lines
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.settings import EpipolarSettings

_GATE_PX = EpipolarSettings().threshold_px
_LEAST_MATCHES = 60
_BEYOND_PX = -1.5  # disparity of a point at infinity with its noise
_BETTER, _GOOD = 0.75, 0.6  # cost against the given calibration's, and least share explained
_SAME = 1.02
_POOR = 0.5
_WRONG_PX, _DOUBTFUL_PX = _GATE_PX, 0.5  # misfit: a lens's own residuals are 0.1 to 0.4 px
_GAIN_WRONG, _GAIN_DOUBTFUL = 0.15, 0.05  # of the share explained
_COST_GAIN = 0.03
_PRIOR_DEG = 0.1  # good calibrations agree with each other to that
_LENS_PX, _LENS_CELLS = 0.5, 16  # residuals of a lens are one error per part of the image
_MOST_FITTED = 2000
_LOSS_PX = (20.0, 1.0)


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a rig explains matches (N, 4): signed distance (N,) of the right point to its line
    and disparity (N,), both pixels, NaN outside the camera model; which are explained (N,)."""

    distance_px: FloatArray
    disparity_px: FloatArray
    explained: BoolArray

    @property
    def share(self) -> float:
        """Share of the matches explained."""
        return float(self.explained.mean())

    @property
    def cost_px(self) -> float:
        """Mean distance, that of a match not explained taken as the gate's threshold."""
        return float(np.where(self.explained, np.abs(self.distance_px), _GATE_PX).mean())


@dataclass(frozen=True, slots=True)
class TurnedRig:
    """A rig with other stereo extrinsics (see `moved`), its fit, and by how much they differ: (5,)
    rad."""

    rig: StereoRig
    fit: Fit
    delta: FloatArray

    @property
    def angle(self) -> float:
        """By how much the right camera is turned against the one given, rad."""
        return float(np.linalg.norm(self.delta[:3]))


def fit_of(pixels: FloatArray, rig: StereoRig) -> Fit:
    """How well the rig explains stereo matches (N, 4) in pixels."""
    xy0, xy1 = rig.cam0.normalize(pixels[:, :2]), rig.cam1.normalize(pixels[:, 2:])
    distance = line_distances(xy0, xy1, rig)
    disparity = disparities(xy0, xy1, rig)
    with np.errstate(invalid="ignore"):
        explained = (np.abs(distance) <= _GATE_PX) & (disparity > _BEYOND_PX)
    return Fit(distance, disparity, explained)


def line_distances(xy0: FloatArray, xy1: FloatArray, rig: StereoRig) -> FloatArray:
    """Signed distances (N,) in pixels of right plane points (N, 2) to the left ones' lines.

    To first order in the image itself: a line's normal n becomes A⁻ᵀ n under a map with derivative
    A. At the border of a fisheye image a pixel is many times as wide in the plane as in the middle.
    """
    lines = epipolar_lines(xy0, rig.essential)
    off: FloatArray = (lines[:, :2] * xy1).sum(-1) + lines[:, 2]
    camera = rig.cam1
    J, _ = camera.model.distort_jacobian(xy1, camera.distortion)
    A = camera.matrix[:2, :2] @ J
    (n_x, n_y), det = lines[:, :2].T, A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    normal = np.hypot(A[:, 1, 1] * n_x - A[:, 1, 0] * n_y, A[:, 0, 0] * n_y - A[:, 0, 1] * n_x)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance: FloatArray = off * np.abs(det) / normal
    return distance


def disparities(xy0: FloatArray, xy1: FloatArray, rig: StereoRig) -> FloatArray:
    """How far (N,), in pixels, right points lie from the left ones' points at infinity.

    Positive towards where nearer points are: a point with a negative one is behind the cameras.
    """
    T = rig.T_cam1_cam0
    ray = np.concatenate([xy0, np.ones((len(xy0), 1))], axis=1) @ T[:3, :3].T
    infinity = ray[:, :2] / ray[:, 2:]
    # dx1/d(1/z) of (ray + t/z) at infinity
    nearer = T[:2, 3] - infinity * T[2, 3]
    nearer = nearer / np.linalg.norm(nearer, axis=1, keepdims=True)
    disparity: FloatArray = rig.cam1.fx * ((xy1 - infinity) * nearer).sum(-1)
    return disparity


def check_stereo(
    pixels: FloatArray, rig: StereoRig, locations: Locations
) -> tuple[list[Finding], StereoRig]:
    """Findings about the calibration from stereo matches (N, 4), tested by nothing before.

    The matches in the order of their frames. And the rig to go on with: the one given, or, where it
    is wrong, one that explains the matches.
    """
    if len(pixels) < _LEAST_MATCHES:
        says = f"{len(pixels)} stereo matches only"
        remedy = "check that left and right show the same scene, sharp and lit"
        return [Finding("stereo matches", Severity.DOUBTFUL, says, remedy)], rig
    given = fit_of(pixels, rig)
    free = fitted_extrinsics(pixels, rig, np.inf)
    mistaken = _best_alternative(pixels, rig, _to_beat_px(given, free))
    if mistaken is not None:
        return [_named(mistaken, given, pixels, locations)], mistaken[1]
    turned = corrected_extrinsics(pixels, rig, free)
    severity = _severity(given, turned.fit)
    if severity is Severity.FINE or not _holds(pixels, rig):
        findings = [_as_given(given, locations), _model_finding(pixels, rig, given, locations)]
        return findings, rig
    model = _model_finding(pixels, turned.rig, turned.fit, locations)
    return [_turned(given, turned, severity, locations), model], turned.rig


def beyond_correction(pixels: FloatArray, rig: StereoRig, locations: Locations) -> Finding | None:
    """Why no small correction makes the rig explain stereo matches (N, 4), if none does: a mistake
    of a usual kind, or one that is not known."""
    if len(pixels) < _LEAST_MATCHES:
        return None
    given, free = fit_of(pixels, rig), fitted_extrinsics(pixels, rig, np.inf)
    mistaken = _best_alternative(pixels, rig, _to_beat_px(given, free))
    if mistaken is not None:
        return _named(mistaken, given, pixels, locations)
    explains = max(given.share, free.fit.share) >= _POOR
    return None if explains else _as_given(given, locations)


def _to_beat_px(given: Fit, free: TurnedRig) -> float:
    """The cost below which another rig is believed: that of the free fit, and well below given."""
    return min(_BETTER * given.cost_px, free.fit.cost_px)


def alternatives(rig: StereoRig) -> dict[str, StereoRig]:
    """What the rig would be if it had one of the usual mistakes, by the mistake's name.

    With the `images` swapped, each side's pixels belong to the other camera; see `fit_of`.
    """
    inverted = replace(
        rig, T_imu_cam1=rig.T_imu_cam0 @ rig.T_cam1_cam0,
    )  # fmt: skip
    swapped = replace(
        rig, cam0=rig.cam1, cam1=rig.cam0, T_imu_cam0=rig.T_imu_cam1, T_imu_cam1=rig.T_imu_cam0
    )
    return {"images": swapped, "direction": inverted, **_other_models(rig)}


def _other_models(rig: StereoRig) -> dict[str, StereoRig]:
    """The rig with pinhole and fisheye model exchanged, the numbers left as they are."""
    other = {"radtan": "equidistant", "none": "equidistant", "equidistant": "radtan"}
    try:
        cameras = [_with_model(c, other[c.model.name]) for c in rig.cameras]
    except (KeyError, CalibrationError):
        return {}
    return {"model": replace(rig, cam0=cameras[0], cam1=cameras[1])}


def _with_model(camera: Camera, name: str) -> Camera:
    coefficients = np.resize(camera.distortion, 4) if len(camera.distortion) else np.zeros(4)
    return replace(camera, model=CAMERA_MODELS[name], distortion=coefficients)


def _best_alternative(
    pixels: FloatArray, rig: StereoRig, to_beat_px: float
) -> tuple[str, StereoRig, Fit] | None:
    """The mistake that explains most matches, and at less than this cost.

    Of those that explain them alike, as exchanged images and an inverted pose of rectified cameras
    do, the first one.
    """
    tried = [(name, other, fit_of(pixels, other)) for name, other in alternatives(rig).items()]
    better = [t for t in tried if t[2].cost_px < to_beat_px and t[2].share > _GOOD]
    least = min((t[2].cost_px for t in better), default=0.0)
    return next((t for t in better if t[2].cost_px <= _SAME * least), None)


def _named(
    mistaken: tuple[str, StereoRig, Fit], given: Fit, pixels: FloatArray, locations: Locations
) -> Finding:
    name, other, fit = mistaken
    shares = f"the calibration explains {given.share:.0%} of {len(pixels)} stereo matches"
    if name == "images":
        behind = float(np.mean(given.disparity_px < _BEYOND_PX))
        says = (
            f"left and right are swapped: {shares} and puts {behind:.0%} behind the cameras,"
            f" exchanged it explains {fit.share:.0%}"
        )
        remedy = f"exchange {locations.images}, or the two cameras in the calibration"
        fix = {"recording.exchange_cameras": True}
        return Finding("left and right", Severity.WRONG, says, remedy, fix)
    if name == "direction":
        says = (
            f"the right camera's pose is written the other way round: {shares}, inverted"
            f" {fit.share:.0%}"
        )
        return Finding(
            "extrinsics", Severity.WRONG, says, f"write the inverse into {locations.extrinsics}"
        )
    inner, outer = by_radius(pixels, given, other)
    says = (
        f"the camera model is wrong: {shares}, with '{other.cam0.model.name}' in place of the one"
        f" given {fit.share:.0%}; epipolar distances grow from {inner:.2g} px in the middle to"
        f" {outer:.2g} px outside"
    )
    return Finding("camera model", Severity.WRONG, says, f"change {locations.camera_model}")


def fitted_extrinsics(pixels: FloatArray, rig: StereoRig, prior_rad: float) -> TurnedRig:
    """The rig with the stereo extrinsics that explain matches (N, 4) best.

    Five unknowns (rotation, direction of the baseline; its length can not be seen), robust least
    squares of the distances to the epipolar lines, first with a wide loss, then with a narrow one.
    `prior_rad`: standard deviation of each unknown before; residuals of the lenses count as one
    error of `_LENS_PX` in each of `_LENS_CELLS` parts of the image, however many points are there.
    """
    chosen = pixels[:: -(-len(pixels) // _MOST_FITTED)]
    xy0, xy1 = rig.cam0.normalize(chosen[:, :2]), rig.cam1.normalize(chosen[:, 2:])
    ok = np.isfinite(xy0).all(1) & np.isfinite(xy1).all(1)
    xy0, xy1, delta = xy0[ok], xy1[ok], np.zeros(5)
    n = len(xy0)
    by_prior = _LENS_PX * np.sqrt(n / _LENS_CELLS) / prior_rad

    def residuals(d: FloatArray) -> FloatArray:
        return np.concatenate([line_distances(xy0, xy1, moved(rig, d)), by_prior * d])

    def loss(squares: FloatArray) -> FloatArray:
        """Cauchy's for the distances, none for the prior."""
        out = np.array([np.log1p(squares), 1.0 / (1.0 + squares), -1.0 / (1.0 + squares) ** 2])
        out[:, n:] = squares[n:], np.ones(5), np.zeros(5)
        return out

    rho: Any = loss  # SciPy's stubs want an argument that SciPy does not give
    for scale_px in _LOSS_PX if n >= _LEAST_MATCHES else ():
        delta = least_squares(residuals, delta, loss=rho, f_scale=scale_px, x_scale=0.01).x
    turned = moved(rig, delta)
    return TurnedRig(turned, fit_of(pixels, turned), delta)


def corrected_extrinsics(pixels: FloatArray, rig: StereoRig, free: TurnedRig) -> TurnedRig:
    """The correction to believe: what matches (N, 4) do not show stays as given.

    How far the cameras look inwards and how far one stands before the other hardly change the
    distances to the lines, but all depths: they are held by a prior, unless the `free` fit takes
    off a misfit that matters beside that.
    """
    held = fitted_extrinsics(pixels, rig, np.radians(_PRIOR_DEG))
    return free if misfit_px(held.fit, free.fit) > _DOUBTFUL_PX else held


def misfit_px(fit: Fit, better: Fit) -> float:
    """By how much (rms) the distances change from one fit to another, of what either explains."""
    shown = fit.explained | better.explained
    change = (fit.distance_px - better.distance_px)[shown]
    return float(np.sqrt(np.nanmean(change**2))) if np.isfinite(change).any() else 0.0


def _holds(pixels: FloatArray, rig: StereoRig) -> bool:
    """Does what one half of the frames says serve the other half, both ways?"""
    middle = len(pixels) // 2
    halves = pixels[:middle], pixels[middle:]
    for seen, other in (halves, halves[::-1]):
        free = fitted_extrinsics(seen, rig, np.inf)
        turned = corrected_extrinsics(seen, rig, free).rig
        if fit_of(other, turned).cost_px > (1.0 - _COST_GAIN) * fit_of(other, rig).cost_px:
            return False
    return True


def moved(rig: StereoRig, delta: FloatArray) -> StereoRig:
    """The rig with the right camera turned by delta[:3] rad, and the baseline by delta[3:]."""
    T = rig.T_cam1_cam0
    across = np.linalg.svd(T[None, :3, 3])[2][1:]  # square to the baseline
    t = so3.exp(delta[3:] @ across) @ T[:3, 3]
    T_cam1_cam0 = se3.make(so3.exp(delta[:3]) @ T[:3, :3], t)
    return replace(rig, T_imu_cam1=rig.T_imu_cam0 @ se3.inverse(T_cam1_cam0))


def _severity(given: Fit, better: Fit) -> Severity:
    """By what a correction changes: the distances to the lines, the matches explained, depths."""
    misfit, gain = misfit_px(given, better), better.share - given.share
    far_off = misfit > _DOUBTFUL_PX and abs(_nearer_px(given, better)) > _WRONG_PX
    if misfit > _WRONG_PX or gain > _GAIN_WRONG or far_off:
        return Severity.WRONG
    doubtful = misfit > _DOUBTFUL_PX or gain > _GAIN_DOUBTFUL
    return Severity.DOUBTFUL if doubtful else Severity.FINE


def _nearer_px(given: Fit, better: Fit) -> float:
    """By how much a correction changes disparities, in the middle of the matches."""
    return float(np.nanmedian(better.disparity_px - given.disparity_px))


def _explains(given: Fit) -> str:
    typical = float(np.nanmedian(np.abs(given.distance_px)))
    return (
        f"the calibration explains {given.share:.0%} of {len(given.explained)} stereo matches"
        f" (typical distance to the epipolar line {typical:.2g} px)"
    )


def _as_given(given: Fit, locations: Locations) -> Finding:
    """That no other extrinsics are better, where the images are the same scene at all."""
    if given.share >= _POOR:
        return Finding("extrinsics", Severity.FINE, _explains(given))
    remedy = f"check {locations.images} (same instant, sharp, lit), then {locations.extrinsics}"
    return Finding("extrinsics", Severity.DOUBTFUL, _explains(given), remedy)


def _turned(given: Fit, turned: TurnedRig, severity: Severity, locations: Locations) -> Finding:
    says = (
        f"{_explains(given)}, and {turned.fit.share:.0%} with the right camera turned by"
        f" {np.degrees(turned.angle):.2g}°, which moves the lines by"
        f" {misfit_px(given, turned.fit):.2g} px and disparities by"
        f" {_nearer_px(given, turned.fit):+.2g} px"
    )
    remedy = f"calibrate the two cameras again, or correct {locations.extrinsics}"
    return Finding("extrinsics", severity, says, remedy)


def _model_finding(pixels: FloatArray, rig: StereoRig, fit: Fit, locations: Locations) -> Finding:
    """Whether distances to the epipolar lines grow outwards, as under a wrong camera model."""
    inner, outer = by_radius(pixels, fit, rig)
    says = f"epipolar distances are {inner:.2g} px in the middle and {outer:.2g} px outside"
    if outer > max(2.0 * inner, _GATE_PX):
        remedy = f"calibrate the cameras again, or correct {locations.camera_model}"
        return Finding("camera model", Severity.DOUBTFUL, f"{says}: they grow", remedy)
    return Finding("camera model", Severity.FINE, says)


def by_radius(pixels: FloatArray, fit: Fit, rig: StereoRig) -> tuple[float, float]:
    """Typical distances, pixels, in the inner and the outer third of the matches by radius."""
    center = rig.cam0.intrinsics[2:4]
    radius = np.linalg.norm(pixels[:, :2] - center, axis=1)
    low, high = np.quantile(radius, (1.0 / 3.0, 2.0 / 3.0))
    distance = np.where(np.isnan(fit.distance_px), np.inf, np.abs(fit.distance_px))
    return float(np.median(distance[radius <= low])), float(np.median(distance[radius >= high]))
