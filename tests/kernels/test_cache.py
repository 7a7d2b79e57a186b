"""Compiled code is found again by another process, and by none that has another source."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

import ovmot
from ovmot.kernels import cache as kept_code
from ovmot.kernels.cache import (
    CodeFolder,
    code_folder,
    code_folders,
    compiled,
    compiled_sources,
    has_code,
    is_warm,
    set_warm,
)

SCRIPT = """
import sys
from pathlib import Path
from ovmot.kernels.cache import code_folder, compiled
import small
kernel = compiled(small.kernel, code_folder(Path(small.__file__)))
assert kernel(20) == small.kernel(20)
print(sum(kernel.stats.cache_hits.values()), kernel(20))
"""
AHEAD = """
import sys
from pathlib import Path
from ovmot.kernels.cache import code_folder, compiled, load_kept
import small
small.compiled_kernel = compiled(small.kernel, code_folder(Path(small.__file__)))
sys.modules["ovmot.trial.small"] = small
load_kept(("other",))
before = len(small.compiled_kernel.signatures)
load_kept(("trial", "missing"))
print(before, len(small.compiled_kernel.signatures), small.compiled_kernel(20))
"""
KERNEL = (
    "def kernel(n):\n    total = 0\n    for i in range(n):\n        total += {}\n    return total\n"
)


def run(folder: Path, cache: Path, script: str = SCRIPT, **extra: str) -> str:
    """What a script prints: hits in the cache and the kernel's value, of a process of its own."""
    source = Path(ovmot.__file__).parents[1]
    path = os.pathsep.join([str(folder), str(source)])
    own = {"PYTHONPATH": path, "XDG_CACHE_HOME": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {**os.environ, **own, **extra}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, check=True, capture_output=True, text=True
    )
    assert done.stderr == ""
    return done.stdout.strip()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.py").write_text(KERNEL.format("i * i"))
    return tmp_path


def test_a_second_process_finds_the_code(folder: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(folder, cache) == "0 2470"
    assert run(folder, cache) == "1 2470"
    (entry,) = (cache / "ovmot").iterdir()
    assert entry.name.startswith("small-")


def test_what_is_kept_is_loaded_ahead(folder: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(folder, cache, AHEAD) == "0 0 2470"
    assert run(folder, cache, AHEAD) == "0 1 2470"
    assert run(folder, cache, AHEAD, NUMBA_CPU_NAME="nehalem") == "0 0 2470"
    for index in (cache / "ovmot").rglob("*.nbi"):
        index.write_bytes(b"spoilt")
    assert run(folder, cache, AHEAD) == "0 0 2470"


def test_another_source_is_compiled_anew(folder: Path, tmp_path: Path) -> None:
    """Even one of the same size and time."""
    cache, source = tmp_path / "cache", folder / "small.py"
    times = source.stat()
    run(folder, cache)
    source.write_text(KERNEL.format("i + i"))
    os.utime(source, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert run(folder, cache) == "0 380"


def test_code_of_another_processor_is_not_taken(folder: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(folder, cache, NUMBA_CPU_NAME="nehalem") == "0 2470"
    assert run(folder, cache, NUMBA_CPU_NAME="generic") == "0 2470"
    assert run(folder, cache, NUMBA_CPU_NAME="generic") == "1 2470"


def test_processes_may_fill_it_at_once(folder: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    with ThreadPoolExecutor(3) as pool:
        outputs = list(pool.map(lambda _: run(folder, cache), range(3)))
    assert {output.split()[1] for output in outputs} == {"2470"}
    assert run(folder, cache) == "1 2470"


def test_spoilt_files_are_as_good_as_none(folder: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run(folder, cache)
    files = [file for file in cache.rglob("*") if file.is_file()]
    assert len(files) >= 2
    for file in files:
        file.write_bytes(file.read_bytes()[:40])
    assert run(folder, cache) == "0 2470"


def test_without_a_writable_folder_nothing_is_kept(folder: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    assert run(folder, blocked) == "0 2470"
    assert run(folder, blocked) == "0 2470"
    assert blocked.read_text() == "no folder"


def test_the_folder_follows_the_users_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "kernel.py"
    source.write_text("one")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "told"))
    one = code_folder(source).own
    source.write_text("two")
    two = code_folder(source).own
    assert one is not None and two is not None
    assert one.parent == two.parent == tmp_path / "told/ovmot"
    assert one != two
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    home = code_folder(source).own
    assert home is not None and home.parent == tmp_path / "home/.cache/ovmot"


def increment(x: int) -> int:
    return x + 1


def test_nothing_of_the_process_is_changed(tmp_path: Path) -> None:
    environment, folder_before = dict(os.environ), vars(numba.config)["CACHE_DIR"]
    assert compiled(increment, CodeFolder(tmp_path, tmp_path / "none"))(1) == 2
    assert any(tmp_path.rglob("*.nbi"))
    assert dict(os.environ) == environment
    assert vars(numba.config)["CACHE_DIR"] == folder_before


def test_what_is_kept_is_counted_and_stamped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    package = tmp_path / "package"
    package.mkdir()
    source = package / "small_kernel.py"
    source.write_text(KERNEL.format("i"))
    (folder,) = code_folders(package)
    assert folder.own is not None
    assert not has_code(folder)
    (folder.own / f"kernel-1.py{sys.version_info[0]}{sys.version_info[1]}.nbi").write_bytes(b"")
    assert has_code(folder)
    assert not is_warm(package)
    set_warm(package)
    assert is_warm(package)
    source.write_text(KERNEL.format("i * i"))  # another version
    assert code_folders(package) != [folder]
    assert not is_warm(package)
    source.write_text(KERNEL.format("i"))
    assert is_warm(package)
    monkeypatch.setattr("numba.config.CPU_NAME", "nehalem")
    assert not is_warm(package)


def test_shipped_code_is_taken_and_the_rest_compiled(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the user has none, also where the user can keep none."""
    run(folder, tmp_path / "builder")
    shipped = tmp_path / "builder/ovmot"
    script = f"""
from pathlib import Path
import ovmot.kernels.cache as cache
cache.SHIPPED = Path({str(shipped)!r})
{SCRIPT}"""
    user, blocked = tmp_path / "user", tmp_path / "file"
    blocked.write_text("no folder")
    assert run(folder, user, script) == "1 2470"
    assert run(folder, blocked, script) == "1 2470"
    assert not list(user.rglob("*.nbi"))
    assert run(folder, user, script, NUMBA_CPU_NAME="nehalem") == "0 2470"
    assert list(user.rglob("*.nbi"))
    for file in shipped.rglob("*.nb?"):
        file.write_bytes(b"spoilt")
    assert run(folder, user, script) == "0 2470"


def test_a_shipped_stamp_says_that_nothing_is_to_be_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "small_kernel.py").write_text(KERNEL.format("i"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "builder"))
    set_warm(package)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    assert not is_warm(package)
    monkeypatch.setattr(kept_code, "SHIPPED", tmp_path / "builder/ovmot")
    assert is_warm(package)


def test_the_same_source_elsewhere_is_the_same_code(folder: Path, tmp_path: Path) -> None:
    """Another environment, another day: what was compiled is found again."""
    cache = tmp_path / "cache"
    assert run(folder, cache) == "0 2470"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "small.py").write_text((folder / "small.py").read_text())
    os.utime(elsewhere / "small.py", ns=(10**18, 10**18))
    assert run(elsewhere, cache) == "1 2470"


def test_another_version_of_numba_has_a_folder_of_its_own(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one folder each would throw away what the other has compiled."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    usual = code_folder(folder / "small.py")
    assert usual.own is not None
    monkeypatch.setattr(numba, "__version__", "0.0.1")
    assert code_folder(folder / "small.py") != usual


def test_the_key_covers_what_a_kernel_calls() -> None:
    source = Path(ovmot.__file__).parent / "segmentation/comparison_kernel.py"
    names = {path.name for path in compiled_sources(source)}
    assert names == {"comparison_kernel.py", "cache.py", "small_matrices.py", "stereo.py"}
    alone = Path(ovmot.__file__).parent / "objects/rigid_kernel.py"
    names = {path.name for path in compiled_sources(alone)}
    assert names == {"rigid_kernel.py", "triangle_kernel.py", "cache.py"}
