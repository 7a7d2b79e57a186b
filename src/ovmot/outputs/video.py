"""`overlay.mp4`: both overlays of every frame, encoded in the background."""

import queue
import threading
from fractions import Fraction
from pathlib import Path

import av
import av.container
import av.video
import cv2
import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.geometry import se3
from ovmot.geometry.arrays import Image
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.outputs.stereo_overlay import draw_stereo
from ovmot.outputs.tracks_overlay import Trails, draw_tracks
from ovmot.types import FeatureFrame, FrameResult

_MAX_WIDTH = 1920
_TICKS_PER_S = 90_000
_NS_PER_S = 1_000_000_000
_WAITING_FRAMES = 8
_BT601, _LIMITED_RANGE = 6, 1  # what `COLOR_BGR2YUV_I420` makes; numbers of ITU-T H.273
_FRAGMENTED = "+frag_keyframe+delay_moov+default_base_moof"
_OPTIONS = {"preset": "superfast", "crf": "23"}


def compose(result: FrameResult, rig: StereoRig, trails: Trails = Trails()) -> Image:  # noqa: B008 - frozen
    """One image of even size (BGR): the stereo overlay, below it the dynamic one as wide.

    The latter also shows the confirmed tracks and their past paths, `trails`.

    It is twice as wide as an image, but no wider than 1920 pixels. Raises `OvmotError` for a frame
    without images.
    """
    frame = result.frame
    if isinstance(frame, FeatureFrame):
        raise OvmotError(f"frame {frame.timestamp_ns}: no images to draw on")
    image_width = frame.left.shape[1]
    width = min(2 * image_width, _MAX_WIDTH)
    upper = draw_stereo(frame, result.matches, rig, width / (2 * image_width))
    scale = width / image_width
    lower = draw_dynamic(frame, result.points, scale)
    T_cam0_world = se3.inverse(result.ego.T_world_imu @ result.ego.T_imu_cam0)
    draw_tracks(lower, result.tracks, trails, T_cam0_world, rig.cam0, scale)
    height = upper.shape[0] + lower.shape[0]
    canvas = np.zeros((height + height % 2, width, 3), dtype=np.uint8)
    for image, top in ((upper, 0), (lower, upper.shape[0])):
        across = min(width, image.shape[1])  # rounding may make a scaled one a pixel wider
        canvas[top : top + image.shape[0], :across] = image[:, :across]
    return canvas


class OverlayVideo:
    """Draws and encodes results in a thread of its own; `write` waits only where that thread is
    behind.

    What goes wrong there is raised by the next `write`, or by `close`. A run without frames
    leaves no file.
    """

    def __init__(self, path: Path, rig: StereoRig) -> None:
        self._path = path
        self._rig = rig
        self._queue: queue.Queue[FrameResult | None] = queue.Queue(_WAITING_FRAMES)
        self._failure: Exception | None = None
        self._closed = False
        self._ended = False  # the worker knows that nothing more comes
        self._thread = threading.Thread(target=self._work, name="overlay", daemon=True)
        self._thread.start()

    def write(self, result: FrameResult) -> None:
        """Hand over one result; raises `OvmotError` where an earlier one could not be written."""
        self._raise_failure()
        self._queue.put(result)

    def close(self) -> None:
        """Encode what still waits and end the file; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        self._raise_failure()

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _work(self) -> None:
        try:
            self._encode_all()
        except (OSError, av.error.FFmpegError) as error:
            self._failure = OvmotError(
                f"{self._path}: cannot write the video: {error.strerror or error}"
            )
        except Exception as error:
            self._failure = error
        while not self._ended:  # after a failure, so that nobody waits for a full queue
            self._next()

    def _next(self) -> FrameResult | None:
        result = self._queue.get()
        self._ended = result is None
        return result

    def _encode_all(self) -> None:
        """One frame is held back: the time to the second one is the stream's nominal rate."""
        first = self._next()
        if first is None:
            return
        second = self._next()
        gap_ns = second.timestamp_ns - first.timestamp_ns if second else _NS_PER_S // 10
        trails = Trails().extended(first)
        image = compose(first, self._rig, trails)
        encoder = _Encoder(self._path, image.shape[1], image.shape[0], gap_ns)
        try:
            encoder.encode(image, 0)
            following = second
            while following is not None:
                elapsed_ns = following.timestamp_ns - first.timestamp_ns
                trails = trails.extended(following)
                encoder.encode(compose(following, self._rig, trails), elapsed_ns)
                following = self._next()
        finally:
            encoder.close()


class _Encoder:
    """An H.264 file that browsers play; each frame is shown at its own time.

    It is written in fragments of 30 frames, each with its index, so that what is there can be
    played however the run ends.
    """

    def __init__(self, path: Path, width: int, height: int, gap_ns: int) -> None:
        rate = Fraction(_NS_PER_S, max(gap_ns, _NS_PER_S // 240)).limit_denominator(1001)
        self._file = path.open("wb")  # of our own: libav says nothing of a full disk
        self._container = av.open(
            self._file, "w", format="mp4", container_options={"movflags": _FRAGMENTED}
        )
        stream = self._container.add_stream("libx264", rate=rate, options=_OPTIONS)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.time_base = Fraction(1, _TICKS_PER_S)
        stream.codec_context.thread_count = 1  # the stream must not depend on the machine's cores
        stream.codec_context.gop_size = 30
        stream.codec_context.colorspace = _BT601  # else players take large images for BT.709
        stream.codec_context.color_range = _LIMITED_RANGE
        self._stream = stream
        self._last_tick = -1

    def encode(self, image: Image, elapsed_ns: int) -> None:
        """Append one BGR image, to be shown `elapsed_ns` after the first one."""
        yuv = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), dtype=np.uint8)
        frame = av.VideoFrame.from_ndarray(yuv, format="yuv420p")
        tick = elapsed_ns * _TICKS_PER_S // _NS_PER_S
        self._last_tick = max(tick, self._last_tick + 1)
        frame.pts = self._last_tick
        frame.time_base = Fraction(1, _TICKS_PER_S)
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Encode what the encoder holds back and end the file; raises where that fails."""
        with self._file:
            try:
                self._container.mux(self._stream.encode(None))
            finally:
                self._container.close()
