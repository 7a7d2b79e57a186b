"""Compiled machine code kept on disk, so that only the first run on a machine compiles.

numba by itself writes beside the sources, or where an environment variable of the process tells.
Here the folder is the user's own, and its name is a hash of the kernel's source and of all that it
calls, and of numba's version: other text, other folder (numba's own check looks at the kernel's
file alone, and two versions in one folder would throw away each other's code).
numba adds Python's version and the processor to the key and writes each file in one move, so that
several processes may share the folder.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding
import numba
import numba.core.caching

_F = TypeVar("_F", bound=Callable[..., Any])
_KEY_LENGTH = 16
_PACKAGE = Path(__file__).parents[1]


def compiled(function: _F, folder: Path | None, *, reorder: bool = False) -> _F:
    """numba's `njit` without Python's lock, its code kept in `folder` (None: in memory only).

    `reorder`: sums may be added up in another order, as several lanes at once need it; the order is
    the same each time, and NaN and infinity keep their meaning.
    """
    if folder is None:
        return _njit(function, cache=False, reorder=reorder)
    config = vars(numba.config)
    before = config["CACHE_DIR"]
    config["CACHE_DIR"] = str(folder)  # read while decorating, and only then
    try:
        dispatcher: Any = _njit(function, cache=True, reorder=reorder)
    except RuntimeError:  # numba found no place that it may write to
        return _njit(function, cache=False, reorder=reorder)
    finally:
        config["CACHE_DIR"] = before
    dispatcher._cache = _Forgiving(dispatcher._cache, folder)
    return cast(_F, dispatcher)


def part(function: _F) -> _F:
    """A function that kernels call, of their own file or of another one; it is kept with them."""
    return cast(_F, _Part(function))


def reordered_part(function: _F) -> _F:
    """The same, with sums that may be added up in another order: see `compiled`."""
    return cast(_F, _Part(function, reorder=True))


def inlined_part(function: _F) -> _F:
    """A part whose code is put where it is called: for small ones, or those called at one place.

    A call counts references to each array that it hands over, which costs more than a few sums.
    """
    return cast(_F, _Part(function, inline=True))


def inlined_reordered_part(function: _F) -> _F:
    """An inlined part whose own sums may be added up in another order: see `compiled`."""
    return cast(_F, _Part(function, reorder=True, inline=True))


class _Part:
    """A function compiled for kernels, without what Python needs to call it.

    That is a fifth of a kernel's compile time; `numba` finds the function by its type. Called from
    Python, as tests do, the same text is compiled once more.
    """

    def __init__(
        self, function: Callable[..., Any], reorder: bool = False, inline: bool = False
    ) -> None:
        functools.update_wrapper(self, function)
        self._options = {"cache": False, "reorder": reorder, "inline": inline}
        self._for_kernels = cast(Any, _njit(function, **self._options, for_kernels=True))
        self._for_kernels.get_call_template = self._template  # asked where a kernel calls it
        self._numba_type_ = self._for_kernels._numba_type_  # refers to it weakly

    def __call__(self, *args: Any) -> Any:
        return self._for_python(*args)

    def _template(self, args: Any, kws: Any) -> Any:
        """numba's, for an argument's type and not its value: `f(x, 0)` and `f(x, n)` share code."""
        plain = tuple(numba.types.unliteral(kind) for kind in args)
        named = {name: numba.types.unliteral(kind) for name, kind in kws.items()}
        return type(self._for_kernels).get_call_template(self._for_kernels, plain, named)

    @functools.cached_property
    def _for_python(self) -> Callable[..., Any]:
        function: Callable[..., Any] = self.__wrapped__  # type: ignore[attr-defined]
        return _njit(function, **self._options)


def _njit(
    function: _F, cache: bool, reorder: bool, inline: bool = False, for_kernels: bool = False
) -> _F:
    fastmath = {"reassoc", "contract", "nsz"} if reorder else False
    njit: Any = numba.njit  # its stub does not know every option
    decorate = njit(
        nogil=True, error_model="numpy", cache=cache, fastmath=fastmath,
        forceinline=inline, no_cfunc_wrapper=True, no_cpython_wrapper=for_kernels,
    )  # fmt: skip
    return cast(_F, decorate(function))


def load_kept(folders: tuple[str, ...]) -> None:
    """Load what is kept of the kernels imported so far from these folders of the package.

    Code is else loaded at its first call, some 10 ms for each kernel: the frame in which something
    happens for the first time would be late.
    """
    names = tuple(f"ovmot.{folder}." for folder in folders)
    modules = [module for name, module in list(sys.modules.items()) if name.startswith(names)]
    for value in [value for module in modules for value in vars(module).values()]:
        cache = getattr(value, "_cache", None)
        if isinstance(cache, _Forgiving):
            for signature in cache.kept(value.targetctx):
                value.compile(signature)


def code_folders(package: Path) -> list[Path]:
    """Those of all `*_kernel.py` of this folder, as far as they can be made."""
    folders = (code_folder(source) for source in package.rglob("*_kernel.py"))
    return [folder for folder in folders if folder is not None]


def has_code(folder: Path) -> bool:
    """Is some compiled code kept in it?"""
    return any(folder.glob("*.nbi"))


def warm_stamp(package: Path) -> Path | None:
    """The file whose presence says that all kernels of this folder are compiled and kept.

    Its name is of their sources, of numba, Python and the processor. None where nothing is kept.
    """
    base = _cache_base()
    if base is None:
        return None
    kernels = package.rglob("*_kernel.py")
    sources = {part_of_it for kernel in kernels for part_of_it in compiled_sources(kernel)}
    return base / f"warm-{_key_of(sources, numba.__version__, sys.version, *_processor())}"


def _key_of(sources: Iterable[Path], *texts: str) -> str:
    """A hash of the files' texts, wherever they lie and in whatever order, and of more texts."""
    digests = sorted(hashlib.sha256(source.read_bytes()).digest() for source in sources)
    return hashlib.sha256(b"".join([*digests, *map(str.encode, texts)])).hexdigest()[:_KEY_LENGTH]


def _processor() -> tuple[str, str]:
    """What code is compiled for: name and features, as numba takes them."""
    name, features = vars(numba.config)["CPU_NAME"], vars(numba.config)["CPU_FEATURES"]
    if features is None:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    return name or llvmlite.binding.get_host_cpu_name(), features


class _Forgiving:
    """numba's cache of one function, in a folder that stands for its source.

    numba's own folder and stamp are of the source's path and time, so that the same text in another
    environment would be compiled again. A spoilt file or a full disk is as good as no cache.
    """

    def __init__(self, inner: Any, folder: Path) -> None:
        inner._cache_path = str(folder)
        index: Any = numba.core.caching.IndexDataCacheFile
        inner._cache_file = index(str(folder), inner._impl.filename_base, "")
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled code, or None: then it is compiled anew."""
        try:
            return self._inner.load_overload(signature, target_context)
        except Exception:  # whatever unpickling spoilt bytes may raise
            return None

    def kept(self, target_context: Any) -> list[Any]:
        """The signatures for which this source's code for this processor is kept."""
        try:
            keys = list(self._inner._cache_file._load_index())
        except Exception:  # spoilt bytes
            return []
        key_of, codegen = self._inner._index_key, target_context.codegen()
        return [key[0] for key in keys if key == key_of(key[0], codegen)]

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep compiled code, if that can be done."""
        with contextlib.suppress(OSError, EOFError, pickle.PickleError):
            self._inner.save_overload(signature, data)


def code_folder(source: Path) -> Path | None:
    """The folder of the user's cache for the code compiled from this file; None if not writable.

    Its name holds a hash of numba's version and of all source texts that are compiled into the
    code: see `compiled_sources`.
    """
    base = _cache_base()
    if base is None:
        return None
    try:
        folder = base / f"{source.stem}-{_key_of(compiled_sources(source), numba.__version__)}"
        folder.mkdir(exist_ok=True)
        return folder
    except OSError:  # no disk space
        return None


def _cache_base() -> Path | None:
    """`$XDG_CACHE_HOME/ovmot` or `~/.cache/ovmot` (XDG Base Directory Specification; a relative
    path in the variable counts as unset); None if it cannot be made or written."""
    try:
        given = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = (given if given.is_absolute() else Path.home() / ".cache") / "ovmot"
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            return base
    except (OSError, RuntimeError):  # no such right, no disk space, no home
        return None


def compiled_sources(source: Path) -> tuple[Path, ...]:
    """The files whose text a kernel's machine code depends on, in a fixed order.

    The kernel's own file, those of the compiled functions that it imports (files of this folder and
    other kernels, also through each other), and this one, which holds the compiler's options.
    """
    found = {Path(__file__)}
    waiting = [source]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += _imported_kernels(file)
    return tuple(sorted(found))


def _imported_kernels(file: Path) -> list[Path]:
    names = re.findall(r"^from ovmot\.([\w.]+) import", file.read_text(encoding="utf-8"), re.M)
    kernels = [n for n in names if n.startswith("kernels.") or n.endswith("_kernel")]
    return [_PACKAGE.joinpath(*name.split(".")).with_suffix(".py") for name in kernels]
