"""Segments and ids of a live node: those of its pipelines one after the other, none used twice."""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.types import FrameResult


@dataclass(frozen=True, slots=True)
class Numbers:
    """A segment, the id of a track and that of a feature: where a pipeline's own 0 is moved to."""

    segment: int = 0
    track: int = 0
    feature: int = 0

    def applied(self, result: FrameResult) -> FrameResult:
        """A pipeline's result with its numbers moved up by these."""
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
        """The first numbers that neither these are past nor a result holds that has been moved."""
        features = (result.points.feature_id, result.matches.feature_id)
        return Numbers(
            max(self.segment, result.segment + 1),
            max((self.track, *(t.track_id + 1 for t in result.tracks))),
            max((self.feature, *(int(ids.max()) + 1 for ids in features if len(ids)))),
        )
