"""Try a wheel in an environment of its own, in an empty folder, with nothing of the repository.

    python .ci/try_wheel.py DIST/ovmot-*.whl [--lowest] [--keep FOLDER]

What a new user types: install, demo, report; then the commands that want an extra, without it and
with it. `--lowest` installs every dependency at the lower end of its bounds; else the newest ones
are. Only Python's own library is needed. Times and sizes are printed.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

_BOUND = re.compile(
    r"^Requires-Dist: ([\w.-]+)(?:\[[^]]*\])?[^;\n]*?>=([\w.]+)[^;\n]*(?:; extra == '(\w+)')?$",
    re.MULTILINE,
)
_PLAN = "sequences: {demo: {data: demo/data}}\nsettings: {default: {}}\nseeds: 1\n"

_EXTRAS = {
    "rerun": ("ovmot", "run", "demo/data", "-o", "for_rerun", "--last", "19", "--no-report",
              "--rerun", "run.rrd", "--force"),
    "cluster": ("ovmot", "batch", "plan.yaml", "-o", "batch", "--cluster", "tcp://127.0.0.1:9"),
    "pandas": ("python", "-c", "import ovmot; print(ovmot.Run('demo/out').to_pandas('state'))"),
}  # fmt: skip
"""By extra, a command that asks for it where it is missing."""
_NO_SCHEDULER = "no scheduler answers there"
"""What the one of `cluster` says where it is not missing."""


@dataclass(frozen=True)
class Trial:
    """An environment with the wheel, and an empty folder to work in."""

    folder: Path

    @property
    def work(self) -> Path:
        """Where commands run."""
        return self.folder / "empty"

    def run(self, what: str, *command: object, fails: bool = False) -> tuple[str, float]:
        """What a command says, and its CPU seconds, printed; it ends well, or `fails` by one line.

        The first word is a program of the environment.
        """
        program, *arguments = map(str, command)
        hidden = ("PYTHON", "OVMOT", "VIRTUAL_ENV")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
        cache = {"XDG_CACHE_HOME": str(self.folder / "cache")}
        before, start = _cpu_of_children(), time.monotonic()
        done = subprocess.run(
            [str(self.folder / "venv" / "bin" / program), *arguments], cwd=self.work,
            env=kept | cache, check=False, capture_output=True, text=True,
        )  # fmt: skip
        wall, cpu = time.monotonic() - start, _cpu_of_children() - before
        print(f"{what}: {wall:.2f} s, {cpu:.2f} s of CPU", flush=True)
        traceback = program == "ovmot" and "Traceback" in done.stderr
        if bool(done.returncode) != fails or traceback:
            sys.exit(f"{what} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
        return (done.stderr if fails else done.stdout).strip(), cpu


def main() -> None:
    """Install, run the commands, and check what they leave."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--lowest", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder to work in, made if missing")
    options = parser.parse_args()
    wheel = options.wheel.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if options.keep is None else options.keep.resolve()
        try_wheel(wheel, Trial(folder), options.lowest)


def try_wheel(wheel: Path, trial: Trial, lowest: bool) -> None:
    """The commands of a new user."""
    trial.work.mkdir(parents=True)
    venv.create(trial.folder / "venv", with_pip=True)
    empty = size_mb(trial.folder / "venv")
    bounds = trial.folder / "lowest.txt"
    bounds.write_text("".join(f"{n}=={v}\n" for n, v in lower_bounds(wheel)) if lowest else "")
    pip = ("python", "-m", "pip", "install", "--quiet", "--constraint", bounds)
    trial.run("pip install", *pip, wheel)
    size = size_mb(trial.folder / "venv") - empty
    print(f"wheel {wheel.stat().st_size / 1e6:.1f} MB, installed {size:.0f} MB")
    print(trial.run("ovmot --version", "ovmot", "--version")[0])
    trial.run("ovmot --help", "ovmot", "--help")
    trial.run("import ovmot", "python", "-c", "import ovmot")
    try_demo(trial)
    try_extras(wheel, trial, pip)


def try_demo(trial: Trial) -> None:
    """The first run compiles, the second does not; then their pages."""
    seconds = []
    for name in ("demo", "again"):
        seconds.append(trial.run(f"ovmot demo {name}", "ovmot", "demo", name)[1])
        out = trial.work / name / "out"
        told = json.loads((out / "run.json").read_text())
        metrics = json.loads((out / "metrics.json").read_text())
        print(f"{told['ended']}, ate_yaw_m {metrics['ate_yaw_m']:.3f}")
        if told["ended"] != "finished" or not metrics["ate_yaw_m"] < 0.2:
            sys.exit("the demo's run is not as it should be")
    first, again = seconds
    print(f"compiling: {first - again:.1f} s of CPU, {1 - again / first:.0%} of the first demo")
    trial.run("ovmot report", "ovmot", "report", "demo/out", "again/out", "-o", "both.html")
    for page in ("demo/out/report.html", "both.html"):
        print(f"{page}: {(trial.work / page).stat().st_size / 1e6:.1f} MB")


def try_extras(wheel: Path, trial: Trial, pip: tuple[object, ...]) -> None:
    """Each extra's command names it in one line, and works when it is installed."""
    (trial.work / "plan.yaml").write_text(_PLAN)
    for extra, command in _EXTRAS.items():
        said, _ = trial.run(f"without {extra}", *command, fails=True)
        last = said.splitlines()[-1]
        print(last)
        if f"pip install 'ovmot[{extra}]'" not in last:
            sys.exit(f"does not say what to install:\n{said}")
    before = size_mb(trial.folder / "venv")
    trial.run("pip install of all extras", *pip, f"{wheel}[{','.join(_EXTRAS)}]")
    print(f"extras {size_mb(trial.folder / 'venv') - before:.0f} MB")
    for extra, command in _EXTRAS.items():
        said, _ = trial.run(f"with {extra}", *command, fails=extra == "cluster")
        if extra == "cluster" and _NO_SCHEDULER not in said:
            sys.exit(f"does not look for a scheduler:\n{said}")


def lower_bounds(wheel: Path) -> list[tuple[str, str]]:
    """Name and lowest version of each dependency, those of the extras tried among them."""
    with zipfile.ZipFile(wheel) as files:
        (name,) = (name for name in files.namelist() if name.endswith(".dist-info/METADATA"))
        found = _BOUND.findall(files.read(name).decode())
    return [(name, lowest) for name, lowest, extra in found if not extra or extra in _EXTRAS]


def size_mb(folder: Path) -> float:
    """Size of all files below a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def _cpu_of_children() -> float:
    times = os.times()
    return times.children_user + times.children_system


if __name__ == "__main__":
    main()
