"""`overlay.mp4`: a view of every frame, drawn and encoded in a process of its own."""

import queue
import threading
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from multiprocessing.connection import Connection
from pathlib import Path

import av
import av.container
import av.video
import cv2
import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.geometry.arrays import Image
from ovmot.outputs.trails import Trails
from ovmot.outputs.views import View, draw_view
from ovmot.runtime import HelperProcess
from ovmot.types import FrameResult, StereoFrame

_TICKS_PER_S = 90_000
_NS_PER_S = 1_000_000_000
_WAITING_FRAMES = 16
_BT601, _LIMITED_RANGE = 6, 1  # what `COLOR_BGR2YUV_I420` makes; numbers of ITU-T H.273
_FRAGMENTED = "+frag_keyframe+delay_moov+default_base_moof"
_OPTIONS = {"preset": "superfast", "crf": "23"}


class OverlayVideo:
    """Hands results to another process that draws and encodes them.

    A thread feeds that process, so that `write` waits only where 16 frames wait already. What goes
    wrong there is raised by the next `write`, or by `close`. A run without frames leaves no file.
    """

    def __init__(self, path: Path, rig: StereoRig, view: View = "objects") -> None:
        self._path = path
        self._view = view
        self.process = HelperProcess("ovmot.outputs.video", "serve")
        self._queue: queue.Queue[FrameResult | None] = queue.Queue(_WAITING_FRAMES)
        self._failure: Exception | None = None
        self._closed = False
        self._thread = threading.Thread(
            target=self._feed, args=((str(path), rig, view),), name="overlay", daemon=True
        )
        self._thread.start()

    def write(self, result: FrameResult) -> None:
        """Hand over one result; raises `OvmotError` where an earlier one could not be written."""
        self._raise_failure()
        self._queue.put(_drawn_of(result, self._view))

    def close(self) -> None:
        """Encode what still waits and end the file; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        self.process.close()
        self._raise_failure()

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _feed(self, start: tuple[str, StereoRig, View]) -> None:
        """Send what comes; at the end, or where the process does not take more, get its answer."""
        ended = False
        try:
            self.process.requests.send(start)
            while not ended:
                result = self._queue.get()
                ended = result is None
                self.process.requests.send(result)
        except OSError:
            pass  # it has ended, and its answer says why
        try:
            self._failure = self.process.replies.recv()
        except (EOFError, OSError):
            self._failure = OvmotError(f"{self._path}: the process that writes the video has died")
        while not ended:  # so that nobody waits for a full queue
            ended = self._queue.get() is None


def serve(requests: Connection, replies: Connection) -> None:
    """The other process: draw and encode results until None comes, and say how that went.

    The answer is None, or the exception.
    """
    path, rig, view = requests.recv()
    failure: Exception | None = None
    try:
        _encode_all(Path(path), rig, view, _received(requests))
    except (OSError, av.error.FFmpegError) as error:
        failure = OvmotError(f"{path}: cannot write the video: {error.strerror or error}")
    except Exception as error:
        failure = error
    replies.send(failure)


def _received(requests: Connection) -> Iterator[FrameResult]:
    """The results up to None, or to the end of the process that sends them."""
    try:
        while (result := requests.recv()) is not None:
            yield result
    except EOFError:
        return


def _drawn_of(result: FrameResult, view: View) -> FrameResult:
    """The result without images that the view does not show: they need not be sent."""
    frame = result.frame
    if not isinstance(frame, StereoFrame):
        return result
    right = frame.right if view in ("stereo", "all") else None
    return replace(result, frame=replace(frame, right=right, left_mask=None, right_mask=None))


def _encode_all(path: Path, rig: StereoRig, view: View, results: Iterator[FrameResult]) -> None:
    """One frame is held back: the time to the second one is the stream's nominal rate."""
    first = next(results, None)
    if first is None:
        return
    second = next(results, None)
    gap_ns = second.timestamp_ns - first.timestamp_ns if second else _NS_PER_S // 10
    trails = Trails().extended(first)
    image = draw_view(view, first, rig, trails)
    encoder = _Encoder(path, image.shape[1], image.shape[0], gap_ns)
    try:
        encoder.encode(image, 0)
        following = second
        while following is not None:
            elapsed_ns = following.timestamp_ns - first.timestamp_ns
            trails = trails.extended(following)
            encoder.encode(draw_view(view, following, rig, trails), elapsed_ns)
            following = next(results, None)
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
