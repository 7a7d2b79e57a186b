"""A motion test of your own: which points move is decided by your function.

    python examples/motion_test.py SEQUENCE

The function takes the evidence of a frame's N points and answers for each; a line in `MOTION_TESTS`
gives it a name, which the setting `segmentation.test` chooses.
"""

import sys

import numpy as np

import ovmot
from ovmot.segmentation.motion_tests import MOTION_TESTS, Evidence, Verdict
from ovmot.settings import SegmentationSettings

MOST_PX = 2.0


def reprojection_test(evidence: Evidence, settings: SegmentationSettings) -> Verdict:
    """A point moves where its prediction misses it by more than two pixels in either camera."""
    tested = evidence.in_last  # against the last frame
    with np.errstate(invalid="ignore"):
        moving = tested & (evidence.reprojection_px > MOST_PX)
    return Verdict(tested, moving, unclear=np.zeros_like(tested))


def main(folder: str) -> int:
    """Print how many points of each frame are dynamic; return their sum."""
    MOTION_TESTS["reprojection"] = reprojection_test
    segmentation = ovmot.Settings().segmentation.model_copy(update={"test": "reprojection"})
    sequence = ovmot.open(folder)
    odometry = ovmot.Odometry(
        sequence.rig, sequence.imu_noise, ovmot.Settings(segmentation=segmentation)
    )
    total = 0
    for event in sequence:
        for frame in odometry.add(event):
            dynamic = int(np.count_nonzero(frame.points.label == ovmot.PointLabel.DYNAMIC))
            print(f"{frame.timestamp_ns}: {dynamic} of {len(frame.points.label)} points move")
            total += dynamic
    odometry.finish()
    return total


if __name__ == "__main__":
    ovmot.prepare_process()
    main(sys.argv[1])
