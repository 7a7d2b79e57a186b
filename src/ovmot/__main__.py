"""`ovmot`, and `python -m ovmot`: the command line, to be stopped while it still loads."""

import sys

from ovmot.errors import is_interrupt
from ovmot.runtime import take_signals_as_interrupts

EXIT_INTERRUPTED = 130


def main() -> None:
    """Load the command line, which takes seconds, and run it."""
    take_signals_as_interrupts()
    try:
        from ovmot.cli import app as cli
    except BaseException as error:
        if is_interrupt(error):
            sys.exit(EXIT_INTERRUPTED)
        raise
    cli.main()


if __name__ == "__main__":
    main()
