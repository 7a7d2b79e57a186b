"""`ovmot`, and `python -m ovmot`: the command line, to be stopped while it still loads."""

import sys

EXIT_INTERRUPTED = 130


def main() -> None:
    """Load the command line, which takes seconds, and run it."""
    try:
        from ovmot.cli import app as cli
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    cli.main()


if __name__ == "__main__":
    main()
