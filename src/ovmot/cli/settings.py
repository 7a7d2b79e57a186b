"""`ovmot settings` and `ovmot config`."""

from pathlib import Path
from typing import Annotated

import typer

from ovmot.cli.console import printable
from ovmot.cli.names import PRESET_FORMATS
from ovmot.cli.options import FormatOption, SequenceOption, SetOption
from ovmot.errors import InputError


def settings(
    text: Annotated[
        str, typer.Argument(help="Only those whose name or meaning has this text.")
    ] = "",
) -> None:
    """List the settings with type, default and meaning, and the presets of formats."""
    import ovmot

    rows = [row for row in ovmot.describe_settings() if text.lower() in " ".join(row).lower()]
    presets = [line for line in _preset_lines() if text.lower() in line.lower()]
    if not rows and not presets:
        raise InputError(f"{text}: no setting has it in its name or meaning; see 'ovmot settings'")
    from rich.console import Console
    from rich.table import Column, Table
    from rich.text import Text

    console = Console()
    if not console.is_terminal:
        for key, kind, default, meaning in rows:
            typer.echo(f"{key} = {default}  ({kind}) {meaning}")
        for line in presets:
            typer.echo(line)
        return
    if rows:
        table = Table(Column("setting", no_wrap=True), "type", "default", "meaning")
        for row in rows:
            table.add_row(*(Text(cell) for cell in row))
        console.print(table)
    for line in presets:
        console.print(Text(line))


def config(
    data: Annotated[
        Path | None,
        typer.Argument(help="Data whose format's preset is to be taken; else none is."),
    ] = None,
    format: FormatOption = None,
    sequence: SequenceOption = None,
    config: Annotated[Path | None, typer.Option(help="YAML of settings, as for a run.")] = None,
    set_: SetOption = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what differs from the defaults.")
    ] = False,
) -> None:
    """Print the settings that a run would have as YAML, for --config of a run.

    Presets, the file of --config and --set are in it, later ones winning. Without data,
    --format alone takes a format's preset.
    """
    import ovmot

    given = ovmot.load_run_config(config, set_ or ()).settings
    if data is not None:
        effective = ovmot.open(data, format, sequence).settings(given)
    elif format in PRESET_FORMATS:
        effective = ovmot.PRESETS[format].under(given)
    elif format is None or format in ovmot.DATASETS:
        effective = given
    else:
        raise InputError(f"--format {format}: unknown; known: {', '.join(ovmot.DATASETS)}")
    for line in ovmot.dump_settings(effective, changed).splitlines():
        typer.echo(printable(line))


def _preset_lines() -> list[str]:
    """The presets in words, one line a format."""
    import ovmot

    return [
        f"preset of {name}: {', '.join(f'{key}={value}' for key, value in preset.values.items())}"
        for name, preset in ovmot.PRESETS.items()
    ]
