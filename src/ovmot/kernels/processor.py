"""The processor that kernels are compiled for: the same for nearly all x86 machines.

Code for the instructions of one machine is no quicker for kernels of this size, but it adds up in
another order than that of the next machine, and cannot be given to it. ADR 030.
"""

import llvmlite.binding
import numba

COMMON = "x86-64-v3"
"""Haswell (2013), Excavator (2015) and later: AVX2 and FMA (System V psABI, AMD64 supplement,
"Micro-Architecture Levels")."""

_FEATURES = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")  # what the level adds


def compile_for_common_processor() -> None:
    """Let numba compile for `COMMON` where this machine can run it, and the user asks for no other
    (`NUMBA_CPU_NAME`, `NUMBA_CPU_FEATURES`).

    It is a setting of the whole process, and has no effect on what numba set up before it.
    """
    config = vars(numba.config)
    asked = config["CPU_NAME"] is not None or config["CPU_FEATURES"] is not None
    if not asked and _can_run_common():
        config["CPU_NAME"], config["CPU_FEATURES"] = COMMON, ""


def processor() -> tuple[str, str]:
    """What code is compiled for: name and features, as numba takes them."""
    config = vars(numba.config)
    name, features = config["CPU_NAME"], config["CPU_FEATURES"]
    if features is None:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    return name or llvmlite.binding.get_host_cpu_name(), features


def _can_run_common() -> bool:
    if not llvmlite.binding.get_process_triple().startswith("x86_64"):
        return False
    has = llvmlite.binding.get_host_cpu_features()
    return all(has.get(feature, False) for feature in _FEATURES)
