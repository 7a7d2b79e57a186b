"""Names that options list, as literals: `--help` and completion must not load the readers.

`tests/cli/test_light.py` holds them equal to the registries.
"""

from typing import Literal

FORMATS = ("euroc", "kaist", "kitti", "kitti_raw", "tum_vi", "viode", "uzh_fpv", "4seasons")
"""The keys of `ovmot.DATASETS`."""

PRESET_FORMATS = ("kitti_raw", "viode")
"""The keys of `ovmot.PRESETS`."""

WRITER_FORMATS = (
    "asl", "kaist", "kitti_sync", "kitti_extract", "tum_vi", "viode", "uzh_fpv", "4seasons",
)  # fmt: skip
"""The keys of `ovmot.WRITERS`."""

SCENES = (
    "demo", "traffic", "crossing", "jam", "pullout", "queue", "abreast", "trailer", "arm_in_arm",
    "bus", "cyclists", "empty", "night", "fisheye",
)  # fmt: skip
"""`ovmot.SCENES`."""

View = Literal["objects", "stereo", "dynamic", "all"]
"""`ovmot.View`."""
