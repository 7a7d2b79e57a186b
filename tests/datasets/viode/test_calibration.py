"""Calibration files of VINS-Fusion that are broken."""

from collections.abc import Callable
from pathlib import Path

import pytest

from ovmot.datasets.viode.calibration import read_vins
from ovmot.errors import CalibrationError

Edit = Callable[[Path, str, str], None]


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cam1_pinhole.yaml", "PINHOLE", "MEI", "'model_type': 'MEI' is not known"),
        ("cam1_pinhole.yaml", "fy: 20.0, ", "", "'projection_parameters.fy': this key is missing"),
        ("cam1_pinhole.yaml", "fx: 20.0", "fx: 0.0", "'projection_parameters': impossible camera"),
        ("calibration.yaml", "body_T_cam1", "body_T", "'body_T_cam1': this key is missing"),
    ],
)
def test_broken_vins_files(
    viode: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    folder = viode.parent / "calibration_files"
    edit(folder / name, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_vins(folder / "calibration.yaml")
    assert str(folder / name) in str(caught.value)
