"""The stopwatch adds up its stages, also those that fail."""

import time

import pytest

from ovmot.timing import Stopwatch


def test_a_stage_entered_twice_is_added_up_and_stages_stay_apart() -> None:
    watch = Stopwatch()
    for _ in range(2):
        with watch.stage("match"):
            time.sleep(0.005)
    with watch.stage("split"):
        pass
    assert list(watch.milliseconds) == ["match", "split"]
    assert watch.milliseconds["match"] >= 10.0
    assert 0.0 <= watch.milliseconds["split"] < watch.milliseconds["match"]


def test_a_stage_that_raises_is_timed_and_its_error_passed_on() -> None:
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch.stage("correct"):
        _ = 1 / 0
    assert watch.milliseconds["correct"] >= 0.0
