"""A run as a bag: what a live node would publish, at the stamps of the frames."""

from pathlib import Path

from ovmot.cameras.rig import StereoRig
from ovmot.outputs.tracks_overlay import Trails
from ovmot.outputs.video import compose
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.messages import PathSoFar, frame_messages, overlay_message
from ovmot.types import FrameResult, StereoFrame


class BagOutput:
    """An output of a run (see `outputs.run_writer`); `overlay` adds the pictures of the video."""

    def __init__(
        self, path: Path, rig: StereoRig, *, overlay: bool = False, replace: bool = False
    ) -> None:
        """Start the bag; raises `InputError` as `BagWriter`."""
        self._rig = rig
        self._overlay = overlay
        self._path = PathSoFar()
        self._trails = Trails()
        self._bag = BagWriter(path, replace=replace)

    def write(self, result: FrameResult) -> None:
        self._path = self._path.extended(result)
        said = frame_messages(result, self._path)
        if self._overlay and isinstance(result.frame, StereoFrame):
            self._trails = self._trails.extended(result)
            picture = compose(result, self._rig, self._trails)
            said.append(overlay_message(result.timestamp_ns, picture))
        for published in said:
            self._bag.write(published, result.timestamp_ns)

    def close(self) -> None:
        self._bag.close()
