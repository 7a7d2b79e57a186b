"""Process-wide limits; each test looks at a fresh interpreter, since they act once, on import."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial

import pytest

from ovmot.errors import is_interrupt
from ovmot.runtime import (
    BLAS_THREAD_VARIABLES,
    HeldInterrupts,
    Stopwatch,
    do_together,
    helping_thread,
    take_signals_as_interrupts,
)


def output_of(code: str, **extra: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in BLAS_THREAD_VARIABLES}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment | extra, check=True, capture_output=True,
        text=True, timeout=60,
    )  # fmt: skip
    return done.stdout.strip()


@pytest.mark.parametrize("variable", BLAS_THREAD_VARIABLES)
def test_importing_ovmot_asks_blas_for_one_thread(variable: str) -> None:
    assert output_of(f"import ovmot, os; print(os.environ[{variable!r}])") == "1"


def test_the_users_own_number_of_threads_stands() -> None:
    code = "import ovmot, os; print(os.environ['OMP_NUM_THREADS'])"
    assert output_of(code, OMP_NUM_THREADS="3") == "3"


def test_importing_ovmot_does_not_import_numpy() -> None:
    assert output_of("import ovmot, sys; print('numpy' in sys.modules)") == "False"


def test_prepare_process_turns_opencvs_threads_off() -> None:
    code = "from ovmot.runtime import prepare_process; prepare_process(); import cv2; "
    assert output_of(code + "print(cv2.getNumThreads())") == "1"


def test_prepare_process_holds_blas_to_one_thread_after_numpy_was_imported() -> None:
    code = (
        "import numpy; from ovmot.runtime import prepare_process; prepare_process();"
        "import scipy.linalg; from threadpoolctl import threadpool_info;"
        "print({i['num_threads'] for i in threadpool_info() if i['user_api'] == 'blas'})"
    )
    assert output_of(code) == "{1}"


def test_an_odometry_prepares_a_process_that_has_numpy_already() -> None:
    code = (
        "import numpy as np, ovmot; from threadpoolctl import threadpool_info;"
        "camera = ovmot.Camera.make((320, 240), (200.0, 200.0), (160.0, 120.0));"
        "right = np.eye(4); right[0, 3] = 0.3;"
        "ovmot.Odometry(ovmot.StereoRig.make(camera, camera, np.eye(4), right));"
        "import cv2;"
        "blas = {i['num_threads'] for i in threadpool_info() if i['user_api'] == 'blas'};"
        "print(blas, cv2.getNumThreads())"
    )
    assert output_of(code) == "{1} 1"


def test_a_stage_entered_twice_is_added_up_and_stages_stay_apart() -> None:
    watch = Stopwatch()
    for _ in range(2):
        with watch.stage("track"):
            time.sleep(0.005)
    with watch.stage("segment"):
        pass
    assert list(watch.milliseconds) == ["track", "segment"]
    assert watch.milliseconds["track"] >= 10.0
    assert 0.0 <= watch.milliseconds["segment"] < watch.milliseconds["track"]


def test_a_stage_that_raises_is_timed_and_its_error_passed_on() -> None:
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch.stage("update"):
        _ = 1 / 0
    assert watch.milliseconds["update"] >= 0.0


def test_jobs_done_together_give_their_results_in_order() -> None:
    jobs = [partial(pow, k, 2) for k in range(20)]
    for threads in (1, 2):
        with helping_thread(threads) as helper:
            assert do_together(jobs, helper) == [k**2 for k in range(20)]
            assert do_together([], helper) == []


def test_what_a_job_raises_comes_through() -> None:
    def fail() -> None:
        raise ValueError("no")

    for threads in (1, 2):
        with helping_thread(threads) as helper, pytest.raises(ValueError, match="no"):
            do_together([fail, fail], helper)


@pytest.fixture
def sigint() -> Iterator[None]:
    """SIGINT as Python has it; where a shell runs the tests in the background, it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("sigint")
def test_signals_are_held_until_it_is_asked() -> None:
    before = signal.getsignal(signal.SIGINT)
    with HeldInterrupts() as interrupts:
        interrupts.check()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        interrupts.check()
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.usefixtures("sigint")
def test_a_second_signal_is_not_held_but_at_the_end() -> None:
    with HeldInterrupts() as interrupts:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        interrupts.hold_all()
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)


def test_only_signals_that_would_interrupt_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGTERM as the command line takes it; another program's own handlers stay its own."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        take_signals_as_interrupts()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        take_signals_as_interrupts()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # nohup
        with HeldInterrupts() as interrupts:
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            signal.raise_signal(signal.SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                interrupts.check()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_in_another_thread_there_is_nothing_to_hold() -> None:
    failures: list[BaseException] = []

    def enter() -> None:
        try:
            with HeldInterrupts() as interrupts:
                interrupts.check()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert failures == []


def test_what_libraries_make_of_an_interrupt_is_one() -> None:
    def loaded() -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise SystemError("returned a result with an exception set") from stop

    with pytest.raises(SystemError) as caught:
        loaded()
    assert is_interrupt(caught.value)
    assert is_interrupt(KeyboardInterrupt())
    assert not is_interrupt(SystemError("other"))
