"""Run the numerical tests once more as other x86-64 processors compute them.

OpenBLAS, NumPy, OpenCV, numba and the C library choose their instructions by the processor, and
with other instructions sums are added up in another order: the last bits differ. Each run here
takes the instructions of one processor away from all five. The tests then have to pass whatever
the last bits are. `make test-portable` runs this. Whole runs of recordings are left to `make test`.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

_NUMERICAL = (
    "cameras", "evaluation", "frontend", "geometry", "initialization", "kernels", "objects",
    "segmentation", "sim/test_render_kernel.py", "vio", "test_feature_table.py", "test_odometry.py",
    "test_physics.py",
)  # fmt: skip
"""Tests of what computes; the others are of files, commands and processes."""

_NEEDS = {"Nehalem": "sse4_2", "Haswell": "avx2", "SkylakeX": "avx512f"}
"""OpenBLAS's name of a processor, and the flag of /proc/cpuinfo without which it is none."""

_AVX512_GLIBC = ("AVX512F", "AVX512BW", "AVX512CD", "AVX512DQ", "AVX512VL")


def instructions(processor: str) -> dict[str, str]:
    """The environment in which all five libraries have this processor's instructions."""
    new = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    avx512 = [name for name in new if name.startswith(("AVX512", "X86_V4"))]
    numpy_without, opencv_without, glibc_without = {
        "Nehalem": (new, ("AVX512-SKX", "AVX2", "FP16", "AVX"), (*_AVX512_GLIBC, "AVX2", "FMA")),
        "Haswell": (avx512, ("AVX512-SKX",), _AVX512_GLIBC),
        "SkylakeX": ([], (), ()),
    }[processor]
    hwcaps = ",".join(f"-{name}" for name in glibc_without)
    return {
        "OPENBLAS_CORETYPE": processor,
        "NUMBA_CPU_NAME": "generic",
        "NPY_DISABLE_CPU_FEATURES": " ".join(numpy_without),
        "OPENCV_CPU_DISABLE": ",".join(opencv_without),
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={hwcaps}" if hwcaps else "",
    }


def passes(what: str, environment: dict[str, str], pytest: list[str]) -> bool:
    """Run the numerical tests; empty values are left out of the environment.

    All kernels are compiled before, so that no two workers compile the same one.
    """
    print(f"== {what}", flush=True)
    given = {**os.environ, **{name: value for name, value in environment.items() if value}}
    warm_up = [sys.executable, "-m", "ovmot", "warmup", "--quiet"]
    subprocess.run(warm_up, env=given, check=True)
    chosen = [str(Path(__file__).parent / name) for name in _NUMERICAL]
    command = [sys.executable, "-m", "pytest", *pytest, *chosen]
    return subprocess.run(command, env=given, check=False).returncode == 0


def main() -> None:
    """One run for each processor named; the exit code is 0 if all pass."""
    parser = argparse.ArgumentParser(description="Run the numerical tests as other processors do.")
    parser.add_argument("--processors", default="", help=f"some of {' '.join(_NEEDS)}; else all")
    arguments, pytest = parser.parse_known_args()
    processors = arguments.processors.split() or list(_NEEDS)
    if not _NEEDS.keys() >= set(processors):
        parser.error(f"choose of {' '.join(_NEEDS)}")
    chosen = os.environ.get("OPENBLAS_CORETYPE")
    if chosen:
        print(f"OPENBLAS_CORETYPE={chosen} is set, and stays: other kernels of BLAS are NOT run")
        sys.exit(not passes("numba's generic processor", {"NUMBA_CPU_NAME": "generic"}, pytest))
    flags = set(Path("/proc/cpuinfo").read_text().split())
    failed = []
    for processor in processors:
        if _NEEDS[processor] not in flags:
            print(f"this processor has no {_NEEDS[processor]}: {processor} is NOT run")
        elif not passes(processor, instructions(processor), pytest):
            failed.append(processor)
    sys.exit(f"failed as on {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
