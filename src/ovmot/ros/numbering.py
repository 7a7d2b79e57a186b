"""Segments and ids of a live node: no number is used twice when the odometry is restarted."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.types import FrameResult


@dataclass(frozen=True, slots=True)
class Numbers:
    """Offsets of segment, track id and feature id that are added to those of one odometry."""

    segment: int = 0
    track: int = 0
    feature: int = 0

    def applied(self, result: FrameResult) -> FrameResult:
        """A result with these offsets added to its numbers."""
        points, matches = result.points, result.matches
        on_track = points.track_id >= 0
        return replace(
            result,
            segment=result.segment + self.segment,
            tracks=tuple(replace(t, track_id=t.track_id + self.track) for t in result.tracks),
            points=replace(
                points,
                feature_id=points.feature_id + self.feature,
                track_id=np.where(on_track, points.track_id + self.track, points.track_id),
            ),
            matches=replace(matches, feature_id=matches.feature_id + self.feature),
        )

    def beyond(self, result: FrameResult) -> "Numbers":
        """Offsets beyond these and beyond all numbers of a result of this node."""
        features = (result.points.feature_id, result.matches.feature_id)
        return Numbers(
            max(self.segment, result.segment + 1),
            max((self.track, *(t.track_id + 1 for t in result.tracks))),
            max((self.feature, *(int(ids.max()) + 1 for ids in features if len(ids)))),
        )
