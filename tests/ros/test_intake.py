"""What waits, what is dropped, and what a jump of the stamps does."""

import numpy as np

from ovmot.config import LiveSettings
from ovmot.ros.intake import Batch, Intake
from ovmot.types import ImuSample

MS = 1_000_000
T0 = 1_700_000_000_000 * MS


def make(queue_frames: int = 3, offset_s: float = 0.0) -> Intake:
    return Intake(LiveSettings(queue_frames=queue_frames, hold_s=3.0, jump_s=0.5), offset_s)


def put_imu(intake: Intake, *at_ms: int) -> None:
    for ms in at_ms:
        intake.put_imu(ImuSample(T0 + ms * MS, np.zeros(3), np.zeros(3)))


def put_pair(intake: Intake, *at_ms: int) -> None:
    for ms in at_ms:
        intake.put_image("left", T0 + ms * MS, ms)
        intake.put_image("right", T0 + ms * MS, ms)


def take(intake: Intake) -> Batch:
    return intake.take(0.0)


def taken_ms(batch: Batch) -> int | None:
    return None if batch.pair is None else (batch.pair.pair.timestamp_ns - T0) // MS


def all_taken_ms(intake: Intake) -> list[int]:
    taken = []
    while (ms := taken_ms(take(intake))) is not None:
        taken.append(ms)
    return taken


def test_a_pair_waits_until_the_imu_covers_it_on_its_own_clock() -> None:
    intake = make(offset_s=0.005)
    put_imu(intake, 0, 100)
    put_pair(intake, 100)
    batch = take(intake)
    assert len(batch.imu) == 2 and batch.pair is None
    put_imu(intake, 105)
    batch = take(intake)
    assert len(batch.imu) == 1 and taken_ms(batch) == 100


def test_a_slow_worker_loses_the_oldest_whole_frames() -> None:
    intake = make(queue_frames=3)
    put_imu(intake, 0, 10_000)
    put_pair(intake, *range(0, 1000, 100))
    assert all_taken_ms(intake) == [700, 800, 900]
    assert intake.counts()["dropped"] == 7


def test_a_hole_in_the_imu_holds_frames_and_a_quick_worker_loses_none() -> None:
    intake = make(queue_frames=3)
    put_imu(intake, 0)
    put_pair(intake, *range(100, 2100, 100))  # two seconds without IMU
    assert take(intake).pair is None
    put_imu(intake, 2050)
    taken = []
    for ms in range(2100, 4100, 100):  # the camera goes on, the worker is twice as fast
        put_imu(intake, ms)
        put_pair(intake, ms)
        taken += [taken_ms(take(intake)), taken_ms(take(intake))]
    assert [ms for ms in taken if ms is not None] == list(range(100, 4100, 100))
    assert intake.counts()["dropped"] == 0
    put_imu(intake, 5100)
    put_pair(intake, *range(4100, 5100, 100))  # the room is as small as before again
    assert all_taken_ms(intake) == [4800, 4900, 5000]


def test_frames_are_not_held_for_ever() -> None:
    intake = make(queue_frames=3)
    put_imu(intake, 0)
    put_pair(intake, *range(100, 60_000, 100))
    assert intake.counts()["dropped"] == 599 - 31


def test_stamps_that_jump_back_begin_again_without_strays() -> None:
    intake = make()
    put_imu(intake, 0, 10_000)
    put_pair(intake, 9900, 10_000)
    put_imu(intake, 0, 10)  # played again from the start
    put_pair(intake, 10_100)  # still on its way from before
    put_pair(intake, 10)
    batch = take(intake)
    assert batch.restart is not None and "imu went back by 10.00 s" in batch.restart
    assert [(s.timestamp_ns - T0) // MS for s in batch.imu] == [0, 10]
    assert taken_ms(batch) == 10
    put_imu(intake, 10_100)
    assert take(intake).restart is not None  # ten seconds without IMU


def test_a_late_message_is_left_out_and_nothing_restarts() -> None:
    intake = make()
    put_imu(intake, 0, 100, 90, 100, 110)
    put_pair(intake, 50, 40)
    batch = take(intake)
    assert batch.restart is None
    assert [(s.timestamp_ns - T0) // MS for s in batch.imu] == [0, 100, 110]
    assert intake.counts()["late"] == 4


def test_a_reset_goes_on_with_the_next_message() -> None:
    intake = make()
    put_imu(intake, 0, 100)
    put_pair(intake, 100)
    intake.restart("asked for")
    put_imu(intake, 110, 200)
    put_pair(intake, 200)
    batch = take(intake)
    assert batch.restart == "asked for"
    assert len(batch.imu) == 2 and taken_ms(batch) == 200


def test_nothing_to_do_is_an_empty_batch() -> None:
    assert take(make()) == Batch()
