"""Events that are not what they promise are refused with their stamp, before anything is done."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError, OvmotError
from ovmot.interfaces import check_event
from ovmot.types import Event, FeatureFrame, ImuSample, StereoFrame

IMAGE = np.zeros((240, 320), dtype=np.uint8)
FRAME = StereoFrame(7, IMAGE, IMAGE)
SAMPLE = ImuSample(7, np.zeros(3), np.array([0.0, 0.0, 9.81]))
NUMPY_STAMP: Any = np.int64(7)
SECONDS: Any = 1.5
FEATURES = FeatureFrame(7, np.arange(5), np.full((5, 4), 50.0))


@pytest.mark.parametrize(
    "event",
    [
        FRAME,
        replace(FRAME, left_mask=IMAGE, right_mask=IMAGE),
        SAMPLE,
        replace(SAMPLE, timestamp_ns=NUMPY_STAMP),
        FEATURES,
        FeatureFrame(7, np.arange(0), np.empty((0, 4))),
    ],
)
def test_good_events(painted_rig: StereoRig, event: Event) -> None:
    check_event(event, painted_rig)
    assert event.timestamp_ns == 7


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (replace(FRAME, left=IMAGE[:100]), "frame 7: the left image must be a grey one of 320x240"),
        (replace(FRAME, right=IMAGE.T), "frame 7: the right image"),
        (replace(FRAME, left=np.dstack([IMAGE] * 3)), "frame 7: the left image"),
        (replace(FRAME, left=IMAGE.astype(np.float32)), "frame 7: the left image .* uint8"),
        (replace(FRAME, right_mask=IMAGE[1:]), "frame 7: the right mask"),
        (replace(FRAME, timestamp_ns=SECONDS), r"stamp 1\.5: write it as a whole number of ns"),
        (replace(SAMPLE, gyro=np.zeros(2)), "IMU sample 7: gyro must be three finite numbers"),
        (replace(SAMPLE, accel=np.full(3, np.nan)), "IMU sample 7: accel"),
        (replace(FEATURES, pixels=np.zeros((4, 4))), "frame 7: features must be N ids"),
        (replace(FEATURES, pixels=np.zeros((5, 2))), "frame 7: features must be N ids"),
    ],
)
def test_malformed_events(painted_rig: StereoRig, event: Event, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        check_event(event, painted_rig)


def test_a_monocular_rig_needs_no_right_image(painted_rig: StereoRig) -> None:
    alone = StereoFrame(7, IMAGE)
    check_event(alone, StereoRig.monocular(painted_rig.cam0, painted_rig.T_imu_cam0))
    with pytest.raises(DatasetError, match="frame 7: the right image must be a grey one"):
        check_event(alone, painted_rig)
    with pytest.raises(OvmotError, match="frame 7: one image where two were expected"):
        _ = alone.pair
    assert FRAME.pair == (IMAGE, IMAGE)
