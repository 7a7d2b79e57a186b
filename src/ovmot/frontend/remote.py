"""A front end in a process of its own, so that it does not share Python's lock with other stages.

Between two threads of one process each call of compiled code or of OpenCV ends with a wait for that
lock. Here the thread that calls `track` waits for another process, which has a lock of its own.
"""

import fcntl
import mmap
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend.here import FrontEndHere
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.interfaces import Feedback, Tracked
from ovmot.runtime import n_processors, prepare_process
from ovmot.settings import EpipolarSettings, TrackerSettings
from ovmot.types import FeatureFrame, StereoFrame

_NO_IMAGE: Image = np.empty((0, 0), dtype=np.uint8)
_IN_FLIGHT = 2
"""Frames that the other process has at a time: the one it works on, and the next."""
_PIPE_BYTES = 1 << 20
"""Room for a request or a reply: neither process then waits until the other one reads."""
_ENDED = "the front end's process has ended: run it again with one thread to see why"


class RemoteFrontEnd:
    """The front end that `tracker.cameras` names, in another process.

    That has the next frame while it works on one, so that it never waits for this process. It ends
    with `close`, and with this process. The answers raise what the front end raises, and
    `OvmotError` where the process has died.
    """

    def __init__(
        self, rig: StereoRig, settings: TrackerSettings, epipolar: EpipolarSettings
    ) -> None:
        here_in, there_out = os.pipe()
        there_in, here_out = os.pipe()
        self._images, images_fd = _make_images(rig)
        self._next_slot = 0
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
        for fd in (here_in, here_out):
            _widen(fd)
        self._replies = Connection(here_in, writable=False)
        self._requests = Connection(here_out, readable=False)
        self._send((rig, settings, epipolar))

    def begin(
        self, frame: StereoFrame | FeatureFrame, T_now_before: FloatArray, feedback: Feedback
    ) -> Callable[[], Tracked]:
        """Send a frame, at most `_IN_FLIGHT` ahead of the last answer; what waits for that."""
        slot = self._next_slot
        self._next_slot = (slot + 1) % _IN_FLIGHT
        if isinstance(frame, StereoFrame):
            self._images[slot].write(frame.left, frame.right)
            right = None if frame.right is None else _NO_IMAGE
            frame = replace(frame, left=_NO_IMAGE, right=right)
        self._send((slot, frame, T_now_before, feedback))
        return self._answer

    def _answer(self) -> Tracked:
        """The oldest frame's that is awaited."""
        try:
            reply: Tracked | Exception = self._replies.recv()
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
        with suppress(OSError):  # it has died: there is no answer either
            _put(self._requests, request)


class _SharedImages:
    """Memory of two processes that holds the images of one frame."""

    def __init__(self, rig: StereoRig, memory: mmap.mmap, slot: int) -> None:
        sizes = [camera.height * camera.width for camera in rig.cameras]
        pixels = np.frombuffer(memory, np.uint8, sum(sizes), slot * sum(sizes))
        self.left: Image = pixels[: sizes[0]].reshape(rig.cam0.height, rig.cam0.width)
        self.right: Image = pixels[sizes[0] :].reshape(rig.cam1.height, rig.cam1.width)

    def write(self, left: Image, right: Image | None) -> None:
        """Put a frame's images there."""
        self.left[:] = left
        if right is not None:
            self.right[:] = right


def _make_images(rig: StereoRig) -> tuple[list[_SharedImages], int]:
    """Room for the images of as many frames as are in flight, and the file that the other process
    opens it by."""
    size = _IN_FLIGHT * sum(camera.height * camera.width for camera in rig.cameras)
    if hasattr(os, "memfd_create"):
        fd = os.memfd_create("ovmot-images")
    else:
        with tempfile.TemporaryFile() as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, size)
    return _open_images(rig, fd), fd


def _open_images(rig: StereoRig, fd: int) -> list[_SharedImages]:
    memory = mmap.mmap(fd, 0)
    return [_SharedImages(rig, memory, slot) for slot in range(_IN_FLIGHT)]


def _widen(fd: int) -> None:
    """Give a pipe more room, where the system lets it."""
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        with suppress(OSError):
            fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def _put(connection: Connection, message: object) -> None:
    """`Connection.send` takes an older protocol, which copies arrays once more."""
    connection.send_bytes(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))


def serve(requests_fd: int, replies_fd: int, images_fd: int) -> None:
    """The other process: answer requests until there are no more."""
    from ovmot.frontend import FRONT_ENDS

    prepare_process()
    requests = Connection(requests_fd, writable=False)
    replies = Connection(replies_fd, readable=False)
    with suppress(EOFError, BrokenPipeError):
        rig, settings, epipolar = requests.recv()
        images = _open_images(rig, images_fd)
        # a second thread helps where a third processor is left for it
        threads = 2 if n_processors() > 2 else 1
        front_end = FrontEndHere(FRONT_ENDS[settings.cameras](rig, settings, epipolar, threads))
        while True:
            slot, frame, T_now_before, feedback = requests.recv()
            if isinstance(frame, StereoFrame):
                right = None if frame.right is None else images[slot].right
                frame = replace(frame, left=images[slot].left, right=right)
            try:
                reply: object = front_end.begin(frame, T_now_before, feedback)()
            except Exception as error:
                reply = error
            _put(replies, reply)
