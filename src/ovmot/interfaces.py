"""What the odometry asks of its events and its parts: front end, odometry source, initializer."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple, Protocol, Self

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.types import (
    EgoEstimate,
    Event,
    FeatureFrame,
    FrontendFrame,
    Health,
    ImuSample,
    PoseWindow,
    StereoFrame,
    StereoMatches,
)
from ovmot.vio.imu_buffer import ImuBuffer


class HiddenFeatures(NamedTuple):
    """L features of bodies that are out of sight, at a frame's stamp: ids, numbers (L,) of their
    bodies, places (L, 3) in the left camera, metres, with a standard deviation (L,) in any
    direction, and velocities (L, 3), m/s."""

    timestamp_ns: int
    feature_id: IntArray
    body: IntArray
    p_cam0: FloatArray
    sigma_m: FloatArray
    velocity: FloatArray


def no_hidden_features() -> HiddenFeatures:
    """Of no body."""
    ids, vectors = np.empty(0, np.int64), np.empty((0, 3))
    return HiddenFeatures(0, ids, ids, vectors, np.empty(0), vectors)


@dataclass(frozen=True, slots=True)
class Feedback:
    """What the later stages of one frame tell the front end and the segmentation of the next.

    `rig`: the calibration as estimated now. `pixel_sigma`: standard deviation of a stereo match's
    pixels as the epipolar distances show it, NaN before the first one.

    Features that move on their own: `moving_id` (M,) and their velocities `moving_velocity` (M, 3),
    m/s in the left camera's axes. Where more features are wanted: left pixels `focus_uv` (N, 2) and
    radii `focus_radius_px` (N,). Features that objects hold, which the odometry source leaves
    alone: `held_id` (K,). Those and all that were found dynamic, in any order: `dynamic_id` (D,).
    Features that bodies had, and that may be seen `hidden` no longer.
    """

    rig: StereoRig
    pixel_sigma: float
    moving_id: IntArray
    moving_velocity: FloatArray
    focus_uv: FloatArray
    focus_radius_px: FloatArray
    held_id: IntArray
    dynamic_id: IntArray
    hidden: HiddenFeatures


def no_feedback(rig: StereoRig) -> Feedback:
    """That of a first frame: nothing is known but the calibration."""
    ids = np.empty(0, dtype=np.int64)
    return Feedback(
        rig, float("nan"), ids, np.empty((0, 3)), np.empty((0, 2)), np.empty(0), ids, ids,
        no_hidden_features(),
    )  # fmt: skip


class FrontEnd(Protocol):
    """Features with ids, from one frame to the next."""

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match that the epipolar gate tested.

        `T_now_before` (4, 4): predicted motion of the left camera since the last frame.
        """
        ...

    def close(self) -> None:
        """End its threads and processes; a second call does nothing."""
        ...


class Tracked(NamedTuple):
    """What a front end gives of a frame, and how long that took it."""

    seen: FrontendFrame
    matches: StereoMatches
    milliseconds: float


class FrontEndRunner(Protocol):
    """Runs a front end, here or elsewhere, beside the later stages."""

    def begin(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> Callable[[], Tracked]:
        """Begin a frame; what waits for its answer, to be called once, in the frames' order.

        Arguments as in `FrontEnd.track`. The frame before the last one must have its answer.
        """
        ...

    def close(self) -> None:
        """End its threads and processes; a second call does nothing."""
        ...


class OdometrySource(Protocol):
    """Where the rig is: the filter, or poses from a file. Each step returns a new source."""

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock."""
        ...

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that a frame must wait for, or None."""
        ...

    def predicted_motion(self, before_ns: int, frame_ns: int, imu: ImuBuffer) -> FloatArray:
        """T_now_before (4, 4) of the left camera between two frames that are still to come.

        Raises `DatasetError` where it is not known.
        """
        ...

    def propagate(self, frame_ns: int, imu: ImuBuffer) -> Self:
        """Propagate to the frame's time and clone the pose."""
        ...

    def update(self, table: FeatureTable, history: StereoHistory) -> tuple[Self, FeatureTable]:
        """Update by the features of the table, without dynamic ones and outliers.

        `history` is that of the newest frame, for zero-velocity detection.
        """
        ...

    def marginalize(self, table: FeatureTable) -> tuple[Self, FeatureTable]:
        """Let one clone leave the window."""
        ...

    def window(self) -> PoseWindow:
        """The poses of the window and their covariance."""
        ...

    def calibrated_rig(self) -> StereoRig:
        """The rig as it is calibrated now."""
        ...

    def estimate(self, frame_ns: int) -> EgoEstimate:
        """The state at the newest frame."""
        ...

    def estimate_at(self, imu_ns: int, imu: ImuBuffer) -> EgoEstimate:
        """The state propagated to a time on the IMU's clock."""
        ...

    def health(self, frame_ns: int) -> Health:
        """How far it can be trusted at the newest frame."""
        ...

    def placed(self, T_world_imu: FloatArray) -> Self:
        """The same source, just initialized, with its first pose at this position and heading."""
        ...


class Initializer(Protocol):
    """Looks for an initial state in the frames seen so far."""

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock."""
        ...

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that a frame must wait for, or None."""
        ...

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[OdometrySource, FeatureTable] | str:
        """An odometry source and the table of the frames it has used, or why there is none.

        Either none of the frames are used, and the source is at the first of them; or all are.
        """
        ...


def check_event(event: Event, rig: StereoRig) -> None:
    """Raise `DatasetError`, with the stamp, for an event that is not what its type promises.

    Stamps are whole ns; IMU readings are three finite numbers each; images are uint8 and of their
    camera's size, and so are masks; a monocular rig needs no right one; features are N ids and
    pixels (N, 4).
    """
    stamp = event.timestamp_ns
    if not isinstance(stamp, int | np.integer):
        raise DatasetError(f"stamp {stamp!r}: write it as a whole number of ns")
    if isinstance(event, ImuSample):
        for name, reading in (("gyro", event.gyro), ("accel", event.accel)):
            if np.shape(reading) != (3,) or not all(map(isfinite, np.asarray(reading).tolist())):
                raise DatasetError(f"IMU sample {stamp}: {name} must be three finite numbers")
        return
    if isinstance(event, FeatureFrame):
        if np.shape(event.pixels) != (*np.shape(event.feature_id)[:1], 4):
            raise DatasetError(f"frame {stamp}: features must be N ids and pixels (N, 4)")
        return
    cam0, cam1 = rig.cameras
    optional = ("left mask", "right mask", *(("right image",) if rig.n_cameras == 1 else ()))
    for name, image, camera in (
        ("left image", event.left, cam0), ("left mask", event.left_mask, cam0),
        ("right image", event.right, cam1), ("right mask", event.right_mask, cam1),
    ):  # fmt: skip
        if image is None and name in optional:
            continue
        if not _is_grey(image, (camera.height, camera.width)):
            size = f"{camera.width}x{camera.height}"
            raise DatasetError(
                f"frame {stamp}: the {name} must be a grey one of {size} pixels, uint8"
            )


def _is_grey(image: Image | None, shape: tuple[int, int]) -> bool:
    return isinstance(image, np.ndarray) and image.shape == shape and image.dtype == np.uint8
