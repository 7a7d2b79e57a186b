"""`ovmot warmup`."""

from typing import Annotated

import typer

from ovmot.cli.options import QuietOption


def warmup(
    again: Annotated[bool, typer.Option("--again", help="Also where it was done before.")] = False,
    quiet: QuietOption = False,
) -> None:
    """Compile ahead what the first run on a machine would compile."""
    from ovmot.cli.compiling import compiling
    from ovmot.cli.progress import style_of

    with compiling(style_of(quiet, False), again=again) as wait_for_kernels:
        wait_for_kernels()
