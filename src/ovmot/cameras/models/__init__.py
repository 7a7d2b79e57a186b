"""Camera models: how a lens moves a point of the ideal image plane.

A model works on normalized coordinates (x/z, y/z), without unit. A new model is one file in this
folder, with a class that has `scale`, `distort`, `distort_jacobian` and `undistort` (see
`CameraModel`), a line in `CAMERA_MODELS`, and its compiled form in `cameras.lens_kernel`.
"""

from ovmot.cameras.models.double_sphere import DoubleSphere
from ovmot.cameras.models.equidistant import Equidistant
from ovmot.cameras.models.eucm import EnhancedUnified
from ovmot.cameras.models.model import CameraModel
from ovmot.cameras.models.omni import Omni
from ovmot.cameras.models.radtan import RadialTangential
from ovmot.cameras.models.undistorted import Undistorted

__all__ = ["CAMERA_MODELS", "CameraModel"]

CAMERA_MODELS: dict[str, CameraModel] = {
    "radtan": RadialTangential(),
    "equidistant": Equidistant(),
    "omni": Omni(),
    "eucm": EnhancedUnified(),
    "ds": DoubleSphere(),
    "none": Undistorted(),
}
