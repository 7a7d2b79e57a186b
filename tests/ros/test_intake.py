"""What waits, what is dropped, and what a jump of the stamps does."""

import numpy as np

from ovmot.ros.intake import Batch, Intake
from ovmot.settings import LiveSettings
from ovmot.types import ImuSample

MS = 1_000_000
T0 = 1_700_000_000_000 * MS


def make(queue_frames: int = 3, offset_s: float = 0.0) -> Intake:
    return Intake(LiveSettings(queue_frames=queue_frames, hold_s=3.0), offset_s)


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


def played(
    work_ms: int, hole_ms: tuple[int, int] = (2000, 4000), end_ms: int = 30_000
) -> tuple[list[tuple[int, int]], Intake]:
    """(stamp, end of its work) of each frame of a camera at 10 Hz, by a worker of this speed.

    The clock is ours: messages come at their stamps, the IMU at 100 Hz but for the hole.
    """
    intake, done, idle_ms = make(queue_frames=3), [], 0
    for now_ms in range(0, end_ms, 10):
        if not hole_ms[0] < now_ms < hole_ms[1]:
            put_imu(intake, now_ms)
        if now_ms % 100 == 0:
            put_pair(intake, now_ms)
        if now_ms >= idle_ms and (stamp := taken_ms(take(intake))) is not None:
            idle_ms = now_ms + work_ms
            done.append((stamp, idle_ms))
    return done, intake


def test_a_worker_a_little_quicker_than_the_camera_loses_nothing_by_a_hole_in_the_imu() -> None:
    done, intake = played(work_ms=80)
    assert intake.counts()["dropped"] == 0
    assert [stamp for stamp, _ in done] == list(range(0, 30_000, 100))
    late = {stamp: end - stamp for stamp, end in done}
    assert late[2100] == 4000 - 2100 + 80  # as soon as the IMU is back
    assert late[29_000] == 80  # and all is worked off


def test_a_slow_worker_loses_single_frames_after_a_hole_and_its_lag_shrinks() -> None:
    done, intake = played(work_ms=110)
    stamps = [stamp for stamp, _ in done]
    gaps = np.diff(stamps)
    assert 30 < intake.counts()["dropped"] < 60
    assert gaps.max() <= 300 and np.sum(gaps == 300) <= 3  # one by one, hardly ever two in a row
    in_hole = [stamp for stamp in stamps if 2000 < stamp < 4000]
    assert len(in_hole) >= 15  # of 19: they are not given up
    late = [end - stamp for stamp, end in done]
    assert max(late) < 2200 and max(late[-50:]) <= 500  # three wait, one is worked on


def test_a_worker_of_half_the_cameras_rate_is_bounded_too() -> None:
    done, _ = played(work_ms=200)
    late = [end - stamp for stamp, end in done]
    assert max(late) < 3000 and max(late[-30:]) <= 700
    assert np.diff([stamp for stamp, _ in done]).max() <= 300


def test_frames_are_not_held_for_ever() -> None:
    intake = make(queue_frames=3)
    put_imu(intake, 0)
    put_pair(intake, *range(100, 3100, 100))
    assert intake.counts()["dropped"] == 0
    put_pair(intake, *range(3100, 60_000, 100))
    assert intake.counts()["dropped"] == 599 - 3


def test_frames_are_not_held_for_an_imu_that_never_came() -> None:
    intake = make(queue_frames=3)
    put_pair(intake, *range(0, 2000, 100))
    assert intake.counts()["dropped"] == 20 - 3


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
