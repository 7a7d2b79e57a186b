"""What a process is held to, threads that help, and a stopwatch for the stages of a frame.

Small dense factorisations are slower with several BLAS threads than with one, OpenCV's own
threads gain less than one Python thread per camera, and glibc gives every freed image back to
the kernel. `limit_blas_threads` must run before NumPy is first imported.
"""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, Self, TypeVar

_T = TypeVar("_T")

_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_KEEP_BYTES = 512 * 1024 * 1024
_TOP_PAD_BYTES = 64 * 1024 * 1024
_SWITCH_INTERVAL_S = 2e-4

BLAS_THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def limit_blas_threads() -> None:
    """Ask BLAS for one thread, unless the user's environment already says how many."""
    if "numpy" not in sys.modules:
        for variable in BLAS_THREAD_VARIABLES:
            os.environ.setdefault(variable, "1")


def prepare_process() -> None:
    """Turn OpenCV's thread pool off and let malloc keep the memory of freed images.

    A thread that comes back from compiled code waits for Python's lock for one switch interval at
    most: 5 ms by default, as long as a stage takes, 0.2 ms here.

    BLAS is held to one thread also where NumPy was imported before ovmot, unless the user's
    environment says otherwise.
    """
    import cv2
    import scipy.linalg  # noqa: F401 - has a BLAS of its own, that of the kernels
    from threadpoolctl import threadpool_limits

    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    cv2.setNumThreads(1)
    if all(os.environ.get(variable, "1") == "1" for variable in BLAS_THREAD_VARIABLES):
        threadpool_limits(limits=1, user_api="blas")
    if sys.platform.startswith("linux"):
        try:
            libc = ctypes.CDLL("libc.so.6")
            libc.mallopt(_M_TRIM_THRESHOLD, _KEEP_BYTES)
            libc.mallopt(_M_TOP_PAD, _TOP_PAD_BYTES)
        except (OSError, AttributeError):
            return  # another libc (musl): only speed is lost


def take_signals_as_interrupts() -> None:
    """Let SIGTERM and SIGHUP raise `KeyboardInterrupt`, as Ctrl-C does, also where a shell has
    SIGINT ignored (`command &`); SIGHUP stays ignored where `nohup` wants it."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)


class HeldInterrupts:
    """Ctrl-C and what is taken as it, held until `check` is called, so that no frame is torn.

    A context manager. It holds those signals whose handler would raise `KeyboardInterrupt`
    (`signal.default_int_handler`), where it is entered in the main thread; elsewhere there are none
    to hold. A second one is not held, so that what hangs can be stopped, but after `hold_all`.
    """

    def __init__(self) -> None:
        self._held: list[signal.Signals] = []
        self._asked = False
        self._all = False

    def check(self) -> None:
        """Raise `KeyboardInterrupt` where one is held."""
        if self._asked:
            self._asked = False
            raise KeyboardInterrupt

    def hold_all(self) -> None:
        """Hold all that come from now on: what is left to do is short, and wants to be done."""
        self._all = True

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._held = [
                number
                for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
                if signal.getsignal(number) is signal.default_int_handler
            ]
            for number in self._held:
                signal.signal(number, self._ask)
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._held:
            signal.signal(number, signal.default_int_handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self._asked and not self._all:
            signal.default_int_handler(number, frame)
        self._asked = True


class Stopwatch:
    """Collects milliseconds by stage name; a stage entered twice is added up."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a `with` block under `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = 1e3 * (time.perf_counter() - start)
            self.milliseconds[name] = self.milliseconds.get(name, 0.0) + spent


class HelperProcess:
    """Another Python process that runs `function(requests, replies)` of a module.

    `requests` and `replies` are `multiprocessing.connection.Connection`s. It imports nothing of
    this process's main module, is not reached by Ctrl-C in a terminal, and sees the end of
    `requests` where this process ends, however that happens.
    """

    def __init__(self, module: str, function: str) -> None:
        here_in, there_out = os.pipe()
        there_in, here_out = os.pipe()
        given = (there_in, there_out)
        call = f"from ovmot.runtime import serve_helper; serve_helper{(module, function, *given)}"
        self._process = subprocess.Popen(
            [sys.executable, "-c", call],
            pass_fds=given,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,
        )
        for fd in given:
            os.close(fd)
        self.replies = Connection(here_in, writable=False)
        self.requests = Connection(here_out, readable=False)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def close(self) -> None:
        """Let it finish what it has been sent, and wait for that; a second call does nothing."""
        self.requests.close()
        self.replies.close()
        self._process.wait()


def serve_helper(module: str, function: str, requests_fd: int, replies_fd: int) -> None:
    """What runs in a `HelperProcess`."""
    prepare_process()
    requests = Connection(requests_fd, writable=False)
    replies = Connection(replies_fd, readable=False)
    getattr(import_module(module), function)(requests, replies)


def helping_thread(threads: int) -> Executor:
    """A thread for jobs beside the caller's; with one of `threads`, the caller does them itself."""
    if threads == 1:
        return CallingThread()
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="ovmot")


def do_together(jobs: Sequence[Callable[[], _T]], helper: Executor) -> list[_T]:
    """The results of jobs, in order, done by this thread and by the helper: each takes the next one
    when it is free, so that a helper that gets no processor holds nothing up."""
    if len(jobs) == 1:
        return [jobs[0]()]
    results: dict[int, _T] = {}
    todo = deque(range(len(jobs)))

    def work() -> None:
        while True:
            try:
                index = todo.popleft()
            except IndexError:
                return
            results[index] = jobs[index]()

    beside = helper.submit(work)
    work()
    if not beside.cancel():
        beside.result()
    return [results[index] for index in range(len(jobs))]


def n_processors() -> int:
    """Those that this process may run on: a container or `taskset` may give it fewer than all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class CallingThread(Executor):
    """An executor that does each job where it is submitted, at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The finished job; what it raises is kept in it, but for the user's interrupt."""
        job: Future[Any] = Future()
        try:
            job.set_result(fn(*args, **kwargs))
        except Exception as error:
            job.set_exception(error)
        return job
