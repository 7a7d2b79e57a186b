"""Pages that are made from the code and its files: settings, public API, notebook, sources."""

import json
from pathlib import Path

import ovmot

_API = {
    "Run an odometry": "open Odometry FrameResult EgoEstimate Health ScenePoints PointLabel"
    " StereoMatches ObjectTrack",
    "A rig and events of your own": "StereoRig Camera CAMERA_MODELS ImuNoise ImuSample"
    " StereoFrame FeatureFrame Event GivenFeatures",
    "Settings": "Settings load_settings describe_settings RunConfig load_run_config",
    "Recorded data": "RecordedSequence DATASETS PRESETS WRITERS BagTopics write_calibration"
    " WrittenCalibration poses_from_file",
    "A run into a folder": "run_sequence RunOptions RunSummary RunContext Output Run",
    "Simulate": "simulate SimulatedSequence SCENES",
    "Evaluate": "evaluate Evaluation metrics_table write_metrics write_plots",
    "Process and errors": "prepare_process warm_up OvmotError InputError DatasetError"
    " CalibrationError",
}
"""The public names by what they are for; a name without a place here comes under "More"."""


def settings_page() -> str:
    """Every setting with type, default and help, as `ovmot settings` prints them."""
    lines = [
        "# Settings",
        "",
        "Made from `src/ovmot/settings.py`, where each setting is declared once. `--set KEY=VALUE`",
        "sets one, `--config FILE` takes a YAML file with sections and keys. Unknown keys are",
        "errors. `run.json` has the settings of a run. A default of `None` means: left out.",
        "",
    ]
    section = ""
    for key, kind, default, text in ovmot.describe_settings():
        name, _, leaf = key.partition(".")
        if name != section:
            section = name
            model = ovmot.Settings.model_fields[name].annotation
            lines += ["", f"## {name}", "", (model.__doc__ or "").strip() if model else "", ""]
            lines += ["| key | type | default | meaning |", "|---|---|---|---|"]
        cells = (f"`{leaf}`", f"`{kind}`", f"`{default}`", text)
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def api_page() -> str:
    """The public names with their docstrings, by the directive of mkdocstrings."""
    lines = [
        "# Python API",
        "",
        "All names are members of `ovmot`. The home of each is named below it.",
        "Arrays have their shape, unit and frame in each docstring;",
        "[conventions](conventions.md) has frames and signs.",
    ]
    placed = [name for names in _API.values() for name in names.split()]
    more = {"More": " ".join(name for name in ovmot.__all__ if name not in placed)}
    for title, names in (_API | more).items():
        found = [name for name in names.split() if name in ovmot.__all__]
        if found:
            lines += ["", f"## {title}"]
        for name in found:
            lines += ["", f"### ovmot.{name}", "", f"::: {_home(name)}"]
    return "\n".join(lines) + "\n"


def notebook_page(text: str) -> str:
    """The cells of a notebook (JSON) as Markdown, without their results."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    return "\n\n".join(parts) + "\n"


def source_page(root: Path, file: str) -> str:
    """A page that shows the text of a file of the repository."""
    text = (root / file).read_text(encoding="utf-8")
    kind = {"py": "python", "yaml": "yaml", "toml": "toml", "launch": "xml", "xml": "xml"}
    language = kind.get(file.rpartition(".")[2], "text")
    head = f"---\nsearch:\n  exclude: true\n---\n\n# {file}\n\n"
    return f"{head}````{language}\n{text.rstrip()}\n````\n"


def _home(name: str) -> str:
    there = "open_recording" if name == "open" else name
    return f"ovmot.{ovmot._HOME_OF[there]}.{there}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
