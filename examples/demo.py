"""Simulate a street, run ovmot on it, and hold the result against the truth.

    python examples/demo.py [FOLDER]

The three commands that it runs are those that anyone would: `ovmot simulate`, `ovmot run` and
`ovmot evaluate`. Data, run and plots come into FOLDER (default: runs/demo).
"""

import shutil
import subprocess
import sys
import time
from pathlib import Path


def main(folder: Path, duration_s: float = 8.0) -> None:
    """Simulate, run, evaluate; an earlier demo in the folder is replaced."""
    start = time.monotonic()
    data, out = folder / "data", folder / "out"
    if data.exists():
        shutil.rmtree(data)
    ovmot("simulate", data, "--scene", "demo", "--duration", duration_s)
    ovmot("run", data, "-o", out, "--save-points", "--video", "--force")
    ovmot("evaluate", out, "--truth", data)
    print(f"video: {out / 'overlay.mp4'}")
    print(f"page: {out / 'report.html'}")
    print(f"the whole demo took {time.monotonic() - start:.0f} s")


def ovmot(*arguments: object) -> None:
    """Say the command, run it, stop where it fails."""
    words = [str(argument) for argument in arguments]
    print("\n$", " ".join(("ovmot", *words)), flush=True)
    ended = subprocess.run([sys.executable, "-m", "ovmot", *words], check=False)
    if ended.returncode != 0:
        sys.exit(ended.returncode)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/demo"))
