"""A front end in a process of its own, so that it does not share Python's lock with other stages.

Between two threads of one process each call of compiled code or of OpenCV ends with a wait for that
lock. Here the thread that calls `track` waits for another process, which has a lock of its own.
"""

import mmap
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.interfaces import Feedback
from ovmot.runtime import prepare_process
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, FrontendFrame, StereoFrame, StereoMatches

_NO_IMAGE: Image = np.empty((0, 0), dtype=np.uint8)
_ENDED = "the front end's process has ended: run it again with one thread to see why"


class RemoteFrontEnd:
    """The front end that `tracker.cameras` names, in another process.

    It ends with `close`, and with this process. Raises what the front end raises, and `OvmotError`
    where the process has died.
    """

    def __init__(
        self, rig: StereoRig, settings: TrackerSettings, epipolar: EpipolarSettings
    ) -> None:
        here_in, there_out = os.pipe()
        there_in, here_out = os.pipe()
        self._images, images_fd = _SharedImages.make(rig)
        given = (there_in, there_out, images_fd)
        self._process = subprocess.Popen(
            [
                sys.executable, "-c", f"from ovmot.frontend.remote import serve; serve{given}",
            ],
            pass_fds=given,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,  # Ctrl-C is for this process alone
        )  # fmt: skip
        for fd in given:
            os.close(fd)
        self._replies = Connection(here_in, writable=False)
        self._requests = Connection(here_out, readable=False)
        self._send((rig, settings, epipolar))

    def track(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> tuple[FrontendFrame, StereoMatches]:
        """Features of this frame, and every stereo match tested; see `StereoTracker.track`."""
        if isinstance(frame, StereoFrame):
            self._images.write(frame.left, frame.right)
            right = None if frame.right is None else _NO_IMAGE
            frame = replace(frame, left=_NO_IMAGE, right=right)
        self._send((frame, T_now_before, feedback))
        try:
            reply: tuple[FrontendFrame, StereoMatches] | Exception = self._replies.recv()
        except (EOFError, OSError) as error:
            raise OvmotError(_ENDED) from error
        if isinstance(reply, Exception):
            raise reply
        return reply

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._requests.close()
        self._replies.close()
        self._process.terminate()  # it has nothing to save
        self._process.wait()

    def _send(self, request: object) -> None:
        try:
            self._requests.send(request)
        except OSError as error:
            raise OvmotError(_ENDED) from error


class _SharedImages:
    """Memory of two processes that holds the images of one frame."""

    def __init__(self, rig: StereoRig, memory: mmap.mmap) -> None:
        self._memory = memory
        n = rig.cam0.height * rig.cam0.width
        pixels = np.frombuffer(memory, dtype=np.uint8)
        self.left: Image = pixels[:n].reshape(rig.cam0.height, rig.cam0.width)
        self.right: Image = pixels[n:].reshape(rig.cam1.height, rig.cam1.width)

    @classmethod
    def make(cls, rig: StereoRig) -> tuple["_SharedImages", int]:
        """Room for the images of a rig, and the file that the other process opens it by."""
        size = sum(camera.height * camera.width for camera in rig.cameras)
        if hasattr(os, "memfd_create"):
            fd = os.memfd_create("ovmot-images")
        else:
            with tempfile.TemporaryFile() as file:
                fd = os.dup(file.fileno())
        os.ftruncate(fd, size)
        return cls(rig, mmap.mmap(fd, size)), fd

    def write(self, left: Image, right: Image | None) -> None:
        """Put a frame's images there."""
        self.left[:] = left
        if right is not None:
            self.right[:] = right


def serve(requests_fd: int, replies_fd: int, images_fd: int) -> None:
    """The other process: answer requests until there are no more."""
    from ovmot.frontend import FRONT_ENDS

    prepare_process()
    requests = Connection(requests_fd, writable=False)
    replies = Connection(replies_fd, readable=False)
    with suppress(EOFError, BrokenPipeError):
        rig, settings, epipolar = requests.recv()
        images = _SharedImages(rig, mmap.mmap(images_fd, 0))
        front_end = FRONT_ENDS[settings.cameras](rig, settings, epipolar, 2)
        while True:
            frame, T_now_before, feedback = requests.recv()
            if isinstance(frame, StereoFrame):
                right = None if frame.right is None else images.right
                frame = replace(frame, left=images.left, right=right)
            try:
                reply: object = front_end.track(frame, T_now_before, feedback)
            except Exception as error:
                reply = error
            replies.send(reply)
