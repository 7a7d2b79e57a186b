"""The files and keys of each kind of data, as the remedies name them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Locations:
    """Files and keys, in words, of one kind of data."""

    images: str = "the left and the right images"
    imu: str = "the IMU's data"
    extrinsics: str = "the right camera's pose in the calibration"
    mount: str = "the cameras' poses on the IMU in the calibration"
    camera_model: str = "the camera model in the calibration"


_EUROC = Locations(
    images="mav0/cam0/data and mav0/cam1/data",
    imu="mav0/imu0/data.csv",
    extrinsics="T_BS in mav0/cam1/sensor.yaml",
    mount="T_BS in mav0/cam0/sensor.yaml and mav0/cam1/sensor.yaml",
    camera_model="distortion_model in mav0/cam0/sensor.yaml and mav0/cam1/sensor.yaml",
)
_KAIST = Locations(
    images="image/stereo_left and image/stereo_right",
    imu="sensor_data/xsens_imu.csv",
    extrinsics="rectification_matrix and projection_matrix in calibration/right.yaml",
    mount="calibration/Vehicle2Stereo.txt and calibration/Vehicle2IMU.txt",
    camera_model="distortion_model in calibration/left.yaml and calibration/right.yaml",
)
_KITTI = Locations(
    images="the folders of the left and the right images",
    extrinsics="the projection matrix of the right camera in the calib file",
    mount="Tr_imu_velo and Tr_velo_cam in the calib file",
    camera_model="the images: the calib file is for rectified ones",
)
_BY_KIND = {"euroc": _EUROC, "kaist": _KAIST, "kitti": _KITTI}


def locations_of(kind: str, calibration: str | None) -> Locations:
    """The locations of a kind of data; `calibration` is a Kalibr file used in place of its own."""
    own = _BY_KIND.get(kind, Locations())
    if calibration is None:
        return own
    return Locations(
        own.images,
        own.imu,
        f"cam1's T_cn_cnm1 or T_cam_imu in {calibration}",
        f"T_cam_imu in {calibration}",
        f"distortion_model in {calibration}",
    )
