"""The objects' stage of a frame: from segmented points to tracks, and its part of the feedback."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.frontend.corners import focus_areas
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.interfaces import Feedback, HiddenFeatures, no_hidden_features
from ovmot.objects.body import VelocityPrior
from ovmot.objects.body_birth import start_body
from ovmot.objects.body_step_kernel import Body
from ovmot.objects.feature_motions import FeatureHistory
from ovmot.objects.frame_views import views_now
from ovmot.objects.measurement import ObjectMeasurement, measure_objects
from ovmot.objects.motion_evidence import Origin
from ovmot.objects.tracker import ObjectTracker
from ovmot.physics import STEADY_S
from ovmot.segmentation.segmentation import Segmentation
from ovmot.settings import Settings
from ovmot.types import ObjectTrack, PointLabel, PoseWindow, ScenePoints


@dataclass(frozen=True, slots=True)
class ObjectsResult:
    """The tracks of a frame and its points with their tracks' ids.

    `held_id` (K,): features that the odometry source must not use. `moving_id` (M,): features that
    move on with a track, `moving_velocity` (M, 3) in m/s in the left camera's axes. More features
    are wanted around left pixels `focus_uv` (N, 2), within `focus_radius_px` (N,). `hidden`: those
    that bodies out of sight had.
    """

    tracks: tuple[ObjectTrack, ...]
    points: ScenePoints
    held_id: IntArray
    moving_id: IntArray
    moving_velocity: FloatArray
    focus_uv: FloatArray
    focus_radius_px: FloatArray
    hidden: HiddenFeatures

    def feedback(self, rig: StereoRig, pixel_sigma: float, dynamic_id: IntArray) -> Feedback:
        """The feedback for later frames, with the calibration, the pixel noise and the dynamic
        features (D,) of now."""
        return Feedback(
            rig=rig,
            pixel_sigma=pixel_sigma,
            moving_id=self.moving_id,
            moving_velocity=self.moving_velocity,
            focus_uv=self.focus_uv,
            focus_radius_px=self.focus_radius_px,
            held_id=self.held_id,
            dynamic_id=np.union1d(self.held_id, dynamic_id),
            hidden=self.hidden,
        )


class MovingObjects:
    """Keeps the tracks; switched off by `objects.enabled`, it returns the points as they are."""

    def __init__(self, rig: StereoRig, settings: Settings) -> None:
        self._settings = settings.objects
        self._of_points = settings.segmentation
        self._tracker = ObjectTracker(rig, settings.object_tracks)
        self._history = FeatureHistory()
        self._before: PoseWindow | None = None
        self._rng = np.random.default_rng(settings.objects.seed)

    def step(
        self,
        history: StereoHistory,
        now_ns: int,
        segmentation: Segmentation,
        window: PoseWindow,
        rig: StereoRig,
    ) -> ObjectsResult:
        """The objects of the newest frame, by its segmented points.

        `history` is that of these points, `window` holds the updated poses, `rig` is the
        calibration as estimated now.
        """
        if not self._settings.enabled:
            none = np.empty(0, dtype=np.int64)
            return ObjectsResult(
                (),
                segmentation.points,
                none,
                none,
                np.empty((0, 3)),
                np.empty((0, 2)),
                np.empty(0),
                no_hidden_features(),
            )
        tracker = self._tracker
        T_world_cam0 = window.T_world_imu[-1] @ rig.T_imu_cam0
        points = tracker.with_track_ids(segmentation.points)
        recent = history.younger(STEADY_S)
        measurements = measure_objects(
            recent, points, window, rig, self._settings, self._of_points, self._rng
        )
        motions = self._history.add(now_ns, points, T_world_cam0)
        frame = views_now(history.now, motions, now_ns, window, self._before, rig, history.noise)
        self._before = window

        def new_body(measurement: ObjectMeasurement, prior: VelocityPrior) -> tuple[Body, Origin]:
            return start_body(
                measurement.feature_id, measurement.velocity, recent, frame, window, rig, prior
            )

        tracks, points = tracker.step(frame, measurements, points, motions, new_body)
        held = held_features(points, self._settings.max_excluded_share)
        moving, velocity = tracker.predicted_velocities(motions)
        hidden = tracker.hidden_features(frame)
        places = tracker.hidden_places(frame)
        uv, radius_px = focus_areas(points, segmentation.outlier, places, rig.cam0)
        return ObjectsResult(
            tracks, points, np.union1d(held, hidden.feature_id), moving,
            velocity @ T_world_cam0[:3, :3], uv, radius_px, hidden,
        )  # fmt: skip


def held_features(points: ScenePoints, max_share: float) -> IntArray:
    """Ids of the points of tracks that move, or may, which the odometry source must not use.

    At most `max_share` of all points: the tracks with most points stay in the source's view, since
    one that has most of the image may be the street, taken for a body.
    """
    has = np.flatnonzero((points.track_id >= 0) & (points.label != int(PointLabel.STATIC)))
    owner, left = points.track_id[has], max_share * len(points.feature_id)
    held = np.zeros(len(has), dtype=np.bool_)
    count = Counter(owner.tolist())
    for track_id in sorted(count, key=lambda k: (count[k], k)):  # smallest first
        left -= count[track_id]
        if left < 0.0:
            break
        held |= owner == track_id
    return points.feature_id[has[held]]
