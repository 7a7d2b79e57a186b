"""A new body: the filter run over the frames that its measurement was made from."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.body import (
    RIGID_POINTS,
    VelocityPrior,
    advance,
    empty_body,
    with_filled_state,
    with_members,
    with_velocity_prior,
)
from ovmot.objects.body_step_kernel import Body, FrameViews
from ovmot.objects.frame_views import drift_variance, ego_step, views_then
from ovmot.objects.motion_evidence import Origin
from ovmot.types import PoseWindow


def start_body(
    feature_id: IntArray,
    velocity: FloatArray,
    history: StereoHistory,
    frame: FrameViews,
    window: PoseWindow,
    rig: StereoRig,
    prior: VelocityPrior,
) -> tuple[Body, Origin]:
    """A body of features (K,) of the newest frame, which move at about `velocity` (3,), world;
    and where it began.

    From the first of the earlier frames that shows enough of them, with a vague velocity; the
    `prior` of its velocity comes last. So every view counts once.
    """
    own = np.flatnonzero(np.isin(history.feature_id, feature_id))
    shown = np.isfinite(history.p_then[:, own, 2]).sum(1)
    rows = np.flatnonzero(shown >= RIGID_POINTS).tolist()
    earlier = views_then(history, rows, feature_id, frame.timestamp_ns, window, rig)
    frames = [*earlier, _after(frame, history, rows, window, rig)]
    first = frames[0]
    seen = np.isin(first.feature_id, feature_id) & np.isfinite(first.p_world[:, 0])
    centre = np.median(first.p_world[seen], axis=0)
    body = empty_body(first.timestamp_ns, centre, velocity)
    for k, then in enumerate(frames):
        if k > 0:
            body = advance(body, then)
        body = with_filled_state(with_members(body, then, feature_id), then)
    origin = Origin(first.timestamp_ns, centre, first.T_world_cam0)
    return with_velocity_prior(body, prior), origin


def _after(
    frame: FrameViews, history: StereoHistory, rows: list[int], window: PoseWindow, rig: StereoRig
) -> FrameViews:
    """The newest frame as the one after the last of the rows, in the world as it is now."""
    frame = frame._replace(correction=np.eye(4))
    if not rows:
        return frame
    clone = int(np.searchsorted(window.timestamp_ns, history.clone_ns[rows[-1]]))
    step = ego_step(window, clone, len(window.timestamp_ns) - 1, frame.T_world_cam0)
    drift = drift_variance(history.noise, rig, int(history.n_frames[rows[-1]]))
    return frame._replace(step=step, drift_variance=drift)
