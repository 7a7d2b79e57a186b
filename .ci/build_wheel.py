"""Build dist/ovmot-*.whl, with compiled code in it, and the source package.

    python .ci/build_wheel.py [PYTHON ...]

First a wheel without code; each PYTHON (this one, if none is named) installs it in an environment
of its own, with the newest dependencies, and compiles; then the wheel with what they have compiled.
A user's numba and Python take the code that was made by the same ones, and compile what they lack
(docs/adr/030). Only Python's own library is needed.
"""

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"


def main() -> None:
    """Build, compile, build again."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        tools = environment(folder / "tools", sys.executable, "build")
        build(tools, {})
        (plain,) = DIST.glob("*.whl")
        for i, python in enumerate(sys.argv[1:] or [sys.executable]):
            own = environment(folder / f"python{i}", python, str(plain))
            print(f"compiling with {python}", flush=True)
            cache = {"XDG_CACHE_HOME": str(folder / "cache")}
            run(own / "ovmot", "warmup", "--quiet", more=cache)
        build(tools, {"OVMOT_COMPILED_CODE": str(folder / "cache" / "ovmot")})
    for file in sorted(DIST.iterdir()):
        print(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e6:.1f} MB")


def environment(folder: Path, python: str, package: str) -> Path:
    """The programs of a new environment of some Python with a package in it."""
    if python == sys.executable:
        venv.create(folder, with_pip=True)
    else:
        run(python, "-m", "venv", folder)
    programs = folder / "bin"
    run(programs / "pip", "install", "--quiet", "--disable-pip-version-check", package)
    return programs


def build(tools: Path, more: dict[str, str]) -> None:
    """The source package, and the wheel from it, in place of what is in `DIST`."""
    for old in DIST.glob("*"):
        old.unlink()
    run(tools / "python", "-m", "build", "--outdir", DIST, ROOT, more=more)


def run(program: Path | str, *arguments: object, more: dict[str, str] | None = None) -> None:
    """A command that ends well, away from the repository; what it says, only if it does not."""
    hidden = ("PYTHON", "OVMOT", "VIRTUAL_ENV", "NUMBA")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    done = subprocess.run(
        [str(program), *map(str, arguments)], cwd=tempfile.gettempdir(), env=kept | (more or {}),
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        sys.exit(f"{program} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")


if __name__ == "__main__":
    main()
