"""The fixtures of the bags' calibration."""

from bag_fixtures import chain, mount

__all__ = ["chain", "mount"]
