"""4Seasons recordings, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from variant_fixtures import NOISE, write_chain

from ovmot.datasets import open_sequence
from ovmot.errors import CalibrationError

Edit = Callable[[Path, str, str], None]


def test_four_seasons(four_seasons: Path) -> None:
    sequence = open_sequence(four_seasons)
    assert (sequence.kind, len(sequence)) == ("4seasons", 6)
    assert sequence.counts == {"no_imu_noise": 1}
    assert sequence.rig.cam0.fx == 20.5
    np.testing.assert_allclose(sequence.rig.T_imu_cam0[:3, 3], [-0.1, -0.2, -0.3], atol=1e-12)
    np.testing.assert_allclose(sequence.rig.T_cam1_cam0[:3, 3], [-0.3, 0.0, 0.0], atol=1e-12)
    (four_seasons / "times.txt").unlink()
    assert len(open_sequence(four_seasons)) == 6
    folder = four_seasons.parent / "calibration"
    (folder / "imu_config.yaml").write_text(NOISE)
    assert open_sequence(four_seasons).imu_noise is not None
    (four_seasons / "Transformations.txt").unlink()
    write_chain(folder / "camchain.yaml")
    np.testing.assert_array_equal(open_sequence(four_seasons).rig.T_imu_cam0[:3, 3], 0.0)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("../calibration/undistorted_calib_1.txt", "Pinhole", "FOV", "row 1: no pinhole"),
        ("../calibration/undistorted_calib_1.txt", "20.5 20.5", "0 0", "impossible camera"),
        ("../calibration/undistorted_calib_stereo.txt", "1 0 0 -0.3", "2 0 0 -0.3", "no rigid 4x4"),
        ("Transformations.txt", "TS_cam_imu", "TS", "no row '# TS_cam_imu'"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "0.1,0.2,0.3,0,0,0,2", "row 4: no trans"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "0.1,0.2,0.3,nan,0,0,1", "row 4: no trans"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "inf,0.2,0.3,0,0,0,1", "row 4: no trans"),
    ],
)
def test_broken_four_seasons_files(
    four_seasons: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(four_seasons / name, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        open_sequence(four_seasons)
    assert Path(name).name in str(caught.value)
