"""What `ovmot --version` prints."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

import ovmot

_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")


def version_lines() -> list[str]:
    """Version and commit, then Python and the packages that results hang on, then the processor."""
    commit = source_commit()
    of_commit = "" if commit is None else f" (commit {commit})"
    packages = ", ".join(f"{name} {_version_of(name)}" for name in _PACKAGES)
    return [
        f"ovmot {ovmot.__version__}{of_commit}",
        f"Python {platform.python_version()}, {packages}",
        f"{platform.system()} {platform.machine()}, {processor()}",
    ]


def source_commit() -> str | None:
    """The commit that the package was built from, or that its repository stands at; else None."""
    built = files("ovmot") / "commit.txt"
    if built.is_file():
        return built.read_text(encoding="utf-8").strip()
    root = Path(ovmot.__file__).parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        asked = subprocess.run(
            command, cwd=root, check=True, capture_output=True, text=True, timeout=5.0
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return asked.stdout.strip()


def processor() -> str:
    """The processor's name, as its maker calls it where Linux says so."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or "unknown processor")


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
