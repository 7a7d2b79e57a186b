"""The first run on a machine compiles: in processes of their own, while the command begins."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ovmot.cli.console import NOTHING_WRITTEN, interruptible, say
from ovmot.cli.progress import Style, steps


@contextmanager
def compiling(style: Style, *, again: bool = False) -> Iterator[Callable[[], None]]:
    """Compile in processes of their own while the block runs; the value waits for their end.

    Nothing is done where all is compiled already, but `again`. Where the block fails, what is not
    compiled yet is given up.
    """
    from ovmot.warmup.processes import WarmUp, needs_warm_up

    with interruptible(NOTHING_WRITTEN):
        needed = again or needs_warm_up()
    if not needed:
        yield lambda: None
        return
    if style is Style.BAR:
        say("ovmot: the first run on this machine compiles its code; a minute on two cores")

    def wait() -> None:
        with interruptible(NOTHING_WRITTEN), steps("compile", style) as advance:
            work.wait(advance)

    with WarmUp() as work:
        yield wait
