"""Kernels are compiled for a processor that nearly all machines are, unless the user asks."""

import llvmlite.binding
import numba
import pytest

from ovmot.kernels import processor
from ovmot.kernels.processor import COMMON, compile_for_common_processor


@pytest.fixture
def nothing_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CPU_NAME", None)
    monkeypatch.setattr(numba.config, "CPU_FEATURES", None)


@pytest.mark.usefixtures("nothing_asked")
def test_a_machine_with_its_instructions_compiles_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    every = dict.fromkeys(("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "avx512f"), True)
    monkeypatch.setattr(llvmlite.binding, "get_host_cpu_features", lambda: every)
    monkeypatch.setattr(llvmlite.binding, "get_process_triple", lambda: "x86_64-unknown-linux-gnu")
    compile_for_common_processor()
    assert processor.processor() == (COMMON, "")


@pytest.mark.usefixtures("nothing_asked")
@pytest.mark.parametrize(
    ("triple", "features"),
    [
        ("x86_64-unknown-linux-gnu", {"sse4.2": True, "avx2": False}),
        ("aarch64-unknown-linux-gnu", {"neon": True}),
    ],
)
def test_another_machine_compiles_for_itself(
    triple: str, features: dict[str, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(llvmlite.binding, "get_host_cpu_features", lambda: features)
    monkeypatch.setattr(llvmlite.binding, "get_process_triple", lambda: triple)
    compile_for_common_processor()
    assert vars(numba.config)["CPU_NAME"] is None
    assert vars(numba.config)["CPU_FEATURES"] is None


@pytest.mark.usefixtures("nothing_asked")
def test_what_the_user_asks_for_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CPU_NAME", "nehalem")
    compile_for_common_processor()
    assert vars(numba.config)["CPU_NAME"] == "nehalem"
    assert vars(numba.config)["CPU_FEATURES"] is None
