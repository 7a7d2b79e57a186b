"""The fixtures that these tests share with those of other folders."""

from street_fixtures import (
    body,
    compared_case,
    drive,
    in_view,
    measure,
    rig,
    scene_of,
    window_of,
)

__all__ = [
    "body",
    "compared_case",
    "drive",
    "in_view",
    "measure",
    "rig",
    "scene_of",
    "window_of",
]
