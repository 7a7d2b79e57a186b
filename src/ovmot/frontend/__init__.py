"""The front end: from the images of a stereo frame to features with ids.

`FRONT_ENDS` makes one by the setting `tracker.cameras`; `given_features` is the one for features
that come from elsewhere.
"""

from collections.abc import Callable

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.monocular_tracker import MonocularTracker
from ovmot.frontend.preprocessing import LEFT, RIGHT
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.settings import EpipolarSettings, TrackerSettings

ImageFrontEnd = StereoTracker | MonocularTracker
_Make = Callable[[StereoRig, TrackerSettings, EpipolarSettings, int], ImageFrontEnd]


def _alone(*sides: int) -> _Make:
    return lambda rig, settings, _, threads: MonocularTracker(rig, settings, sides, threads)


FRONT_ENDS: dict[str, _Make] = {
    "stereo": StereoTracker,
    "left": _alone(LEFT),
    "each": _alone(LEFT, RIGHT),
}
