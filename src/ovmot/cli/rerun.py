"""`ovmot run --rerun`."""

from collections.abc import Callable

import ovmot


def rerun_output(target: str, force: bool) -> Callable[[ovmot.RunContext], ovmot.Output]:
    """The output that records for Rerun, made when the run begins."""
    return lambda context: ovmot.RerunOutput(target, context.rig, replace=force)
