"""Remedies name the files of the data at hand."""

from ovmot.doctor.locations import Locations, locations_of


def test_a_known_kind_names_its_own_files() -> None:
    euroc, kaist = locations_of("euroc", None), locations_of("kaist", None)
    assert euroc.imu == "mav0/imu0/data.csv"
    assert kaist.imu == "sensor_data/xsens_imu.csv"
    assert locations_of("some other kind", None) == Locations()


def test_a_calibration_given_beside_the_data_is_the_one_to_correct() -> None:
    given = locations_of("euroc", "chain.yaml")
    assert all("chain.yaml" in x for x in (given.extrinsics, given.mount, given.camera_model))
    assert given.images == locations_of("euroc", None).images
