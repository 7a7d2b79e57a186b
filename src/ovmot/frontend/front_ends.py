"""The front ends by the setting `tracker.cameras`."""

from collections.abc import Callable

from ovmot.cameras.rig import StereoRig
from ovmot.config import EpipolarSettings, TrackerSettings
from ovmot.frontend.separate import LEFT, RIGHT, SeparateTracker
from ovmot.frontend.tracker import StereoTracker

ImageFrontEnd = StereoTracker | SeparateTracker

FRONT_ENDS: dict[str, Callable[[StereoRig, TrackerSettings, EpipolarSettings], ImageFrontEnd]] = {
    "stereo": StereoTracker,
    "left": lambda rig, settings, _: SeparateTracker(rig, settings, (LEFT,)),
    "each": lambda rig, settings, _: SeparateTracker(rig, settings, (LEFT, RIGHT)),
}
