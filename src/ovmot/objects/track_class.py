"""The class of motion of tracks: by the speeds of their bodies, and by what was seen of them."""

from collections.abc import Sequence

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.motion_class import classified
from ovmot.objects.track import Track
from ovmot.objects.track_box import are_whole


def with_classes(
    tracks: Sequence[Track], T_world_cam0: FloatArray, rig: StereoRig
) -> tuple[Track, ...]:
    """The tracks of a frame with the probabilities of their classes, and whether they are whole in
    view.

    A side that no view shows says only how large the body is at least; the usual size that the box
    has there says nothing.
    """
    if not tracks:
        return ()
    speed = np.linalg.norm([track.velocity[:2] for track in tracks], axis=1)
    variance = np.array([np.trace(track.velocity_cov[:2, :2]) for track in tracks])
    histories, probability = classified(
        [track.speeds for track in tracks],
        speed,
        np.sqrt(0.5 * variance),
        np.array([track.box.shown.extent for track in tracks]),
        np.array([track.box.shown.sigma for track in tracks]),
        np.array([track.box.shown.faces for track in tracks]),
    )
    each = zip(tracks, histories, probability, are_whole(tracks, T_world_cam0, rig), strict=True)
    return tuple(
        track._replace(speeds=speeds, class_probability=p, whole=whole)
        for track, speeds, p, whole in each
    )
