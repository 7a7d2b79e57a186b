"""The fixtures that these tests share with those of other folders."""

from sim_fixtures import (
    assert_same_rig,
    small_simulation,
)

__all__ = ["assert_same_rig", "small_simulation"]
