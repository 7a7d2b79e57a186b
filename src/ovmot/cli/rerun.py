"""`ovmot run --rerun`."""

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ovmot import Output, RunContext


def rerun_output(target: str, force: bool) -> "Callable[[RunContext], Output]":
    """The output that records for Rerun, made when the run begins."""
    import ovmot

    return lambda context: ovmot.RerunOutput(target, context.rig, replace=force)
