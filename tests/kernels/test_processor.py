"""Compiled code is that of the processor which the environment names, as test-portable does."""

import os

import numpy as np
import scipy.linalg  # noqa: F401 - loads SciPy's own OpenBLAS beside NumPy's
from numba.core.registry import cpu_target
from threadpoolctl import threadpool_info

from ovmot.kernels.processor import COMMON

TESTED = ("Nehalem", "Haswell", "SkylakeX")


def test_numpy_and_scipy_use_the_kernels_of_blas_that_were_asked_for() -> None:
    found = [x["architecture"] for x in threadpool_info() if x["internal_api"] == "openblas"]
    assert len(found) >= 2
    asked = os.environ.get("OPENBLAS_CORETYPE")
    # under other names, or none, each version of OpenBLAS may take a near relative's kernels: on a
    # processor of the Zen family NumPy's says Haswell and SciPy's Zen
    if asked in TESTED:
        assert set(found) == {asked}


def test_numba_compiles_for_the_processor_that_was_asked_for() -> None:
    _, name, features = cpu_target.target_context.codegen().magic_tuple()
    asked = os.environ.get("NUMBA_CPU_NAME")
    assert name == asked if asked else name not in ("", "generic")
    assert (features == "") == (name in (COMMON, "generic"))


def test_numpy_does_without_the_instructions_that_were_taken_away() -> None:
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    taken = os.environ.get("NPY_DISABLE_CPU_FEATURES", "").split()
    assert extensions["baseline"]
    assert not set(taken) & set(extensions.get("found", []))
