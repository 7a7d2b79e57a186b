"""Try a wheel in an environment of its own, in an empty folder, with nothing of the repository.

    python .ci/try_wheel.py DIST/ovmot-*.whl [--lowest] [--extra NAME ...] [--keep FOLDER]

`--lowest` installs every dependency at the lower end of its bounds; else the newest ones are. Only
Python's own library is needed. Times and sizes are printed.
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
from pathlib import Path

_BOUND = re.compile(r"^Requires-Dist: ([\w.-]+)[^;]*?>=([\w.]+)[^;]*$", re.MULTILINE)


def main() -> None:
    """Install, run the commands, and check what they leave."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--lowest", action="store_true")
    parser.add_argument("--extra", action="append", default=[])
    parser.add_argument("--keep", type=Path, help="folder to work in, made if missing")
    options = parser.parse_args()
    wheel = options.wheel.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if options.keep is None else options.keep.resolve()
        try_wheel(wheel, folder, options.lowest, options.extra)


def try_wheel(wheel: Path, folder: Path, lowest: bool, extras: list[str]) -> None:
    """The commands of a new user, in `folder`."""
    environment = folder / "venv"
    work = folder / "empty"
    work.mkdir(parents=True)
    venv.create(environment, with_pip=True)
    python = environment / "bin" / "python"
    wanted = [f"{wheel}[{','.join(extras)}]" if extras else str(wheel)]
    if lowest:
        bounds = folder / "lowest.txt"
        bounds.write_text("".join(f"{n}=={v}\n" for n, v in lower_bounds(wheel)))
        wanted += ["--constraint", str(bounds)]
    timed("pip install", work, python, "-m", "pip", "install", "--quiet", *wanted)
    size = sum(file.stat().st_size for file in environment.rglob("*") if file.is_file())
    print(f"wheel {wheel.stat().st_size / 1e6:.1f} MB, environment {size / 1e6:.0f} MB")
    ovmot = environment / "bin" / "ovmot"
    print(timed("ovmot --version", work, ovmot, "--version").strip())
    timed("ovmot --help", work, ovmot, "--help")
    timed("import ovmot", work, python, "-c", "import ovmot")
    timed("ovmot warmup", work, ovmot, "warmup", "--quiet")
    timed("ovmot demo", work, ovmot, "demo", "--duration", "5", "--no-video")
    told = json.loads((work / "ovmot-demo/out/run.json").read_text())
    metrics = json.loads((work / "ovmot-demo/out/metrics.json").read_text())
    print(f"{told['ended']}, ate_yaw_m {metrics['ate_yaw_m']:.3f}")
    if told["ended"] != "finished" or not metrics["ate_yaw_m"] < 0.2:
        sys.exit("the demo's run is not as it should be")


def lower_bounds(wheel: Path) -> list[tuple[str, str]]:
    """Name and lowest version of each dependency that is no extra's."""
    with zipfile.ZipFile(wheel) as files:
        (name,) = (name for name in files.namelist() if name.endswith(".dist-info/METADATA"))
        return _BOUND.findall(files.read(name).decode())


def timed(what: str, folder: Path, *command: object) -> str:
    """Run a command in a clean environment of variables, and print its wall and CPU time."""
    hidden = ("PYTHON", "OVMOT", "VIRTUAL_ENV")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    cache = {"XDG_CACHE_HOME": str(folder.parent / "cache")}
    before, start = os.times(), time.monotonic()
    done = subprocess.run(
        [str(word) for word in command], cwd=folder, env=kept | cache, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    wall, after = time.monotonic() - start, os.times()
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    print(f"{what}: {wall:.2f} s, {cpu:.2f} s of CPU", flush=True)
    if done.returncode:
        sys.exit(f"{what} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
