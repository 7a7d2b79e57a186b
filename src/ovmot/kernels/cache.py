"""Compiled machine code kept on disk, so that only the first run on a machine compiles.

numba by itself writes beside the sources, or where an environment variable of the process tells.
Here the folder is the user's own, and its name is a hash of the kernel's source and of all that it
calls, and of numba's version: other text, other folder (numba's own check looks at the kernel's
file alone, and two versions in one folder would throw away each other's code).
numba adds Python's version and the processor to the key and writes each file in one move, so that
several processes may share the folder.

A wheel holds such folders too (`SHIPPED`, made by `make wheel`): where its numba, Python and
processor are those of the user, nothing is compiled.
"""

import contextlib
import copy
import functools
import hashlib
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numba.core.caching

from ovmot.kernels.processor import compile_for_common_processor, processor

compile_for_common_processor()  # before the first decorator sets numba's compiler up

_F = TypeVar("_F", bound=Callable[..., Any])
_KEY_LENGTH = 16
_PACKAGE = Path(__file__).parents[1]

SHIPPED = Path(__file__).with_name("shipped")
"""Compiled code that came with the package; missing in a clone."""


class CodeFolder(NamedTuple):
    """Where one file's compiled code is kept: by the user, None where nothing can be written, and
    by the package."""

    own: Path | None
    shipped: Path


def compiled(function: _F, folder: CodeFolder | None, *, reorder: bool = False) -> _F:
    """numba's `njit` without Python's lock, its code taken from `folder` and kept there
    (None: in memory only).

    `reorder`: sums may be added up in another order, as several lanes at once need it; the order is
    the same each time, and NaN and infinity keep their meaning.
    """
    if folder is None or (folder.own is None and not folder.shipped.is_dir()):
        return _njit(function, cache=False, reorder=reorder)
    config = vars(numba.config)
    before = config["CACHE_DIR"]
    # read while decorating, and only then: numba wants a folder that it may write to
    config["CACHE_DIR"] = str(folder.own or tempfile.gettempdir())
    try:
        dispatcher: Any = _njit(function, cache=True, reorder=reorder)
    except RuntimeError:  # numba found no place that it may write to
        return _njit(function, cache=False, reorder=reorder)
    finally:
        config["CACHE_DIR"] = before
    dispatcher._cache = _KeptCode(dispatcher._cache, folder)
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
        if isinstance(cache, _KeptCode):
            for signature in cache.kept(value.targetctx):
                value.compile(signature)


def code_folders(package: Path) -> list[CodeFolder]:
    """Those of all `*_kernel.py` of this folder."""
    return [code_folder(source) for source in package.rglob("*_kernel.py")]


def has_code(folder: CodeFolder) -> bool:
    """Is some compiled code kept in it, by the user or the package, for this Python?"""
    places = (folder.own, folder.shipped)
    ending = f"*.py{sys.version_info[0]}{sys.version_info[1]}*.nbi"  # as numba names it
    return any(place is not None and any(place.glob(ending)) for place in places)


def is_warm(package: Path) -> bool:
    """Are all kernels of this folder compiled and kept, by the user or the package?"""
    base, name = _cache_base(), _warm_name(package)
    return (SHIPPED / name).exists() or (base is not None and (base / name).exists())


def set_warm(package: Path) -> None:
    """Note that they are, if that can be done."""
    base = _cache_base()
    if base is not None:
        (base / _warm_name(package)).touch()


def can_keep() -> bool:
    """Is there a folder of the user's for compiled code?"""
    return _cache_base() is not None


def _warm_name(package: Path) -> str:
    """A file's name, of the kernels' sources, of numba, Python and the processor."""
    kernels = package.rglob("*_kernel.py")
    sources = {part_of_it for kernel in kernels for part_of_it in compiled_sources(kernel)}
    python = sys.implementation.cache_tag or sys.version
    return f"warm-{_key_of(sources, numba.__version__, python, *processor())}"


def _key_of(sources: Iterable[Path], *texts: str) -> str:
    """A hash of the files' texts, wherever they lie and in whatever order, and of more texts."""
    digests = sorted(hashlib.sha256(source.read_bytes()).digest() for source in sources)
    return hashlib.sha256(b"".join([*digests, *map(str.encode, texts)])).hexdigest()[:_KEY_LENGTH]


class _KeptCode:
    """numba's cache of one function, in folders that stand for its source.

    numba's own folder and stamp are of the source's path and time, so that the same text in another
    environment would be compiled again. A spoilt file or a full disk is as good as no cache.
    """

    def __init__(self, inner: Any, folder: CodeFolder) -> None:
        self._own = None if folder.own is None else _in_folder(inner, folder.own)
        shipped = _in_folder(inner, folder.shipped) if folder.shipped.is_dir() else None
        self._places = [place for place in (shipped, self._own) if place is not None]
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled code, or None: then it is compiled anew."""
        for place in self._places:
            with contextlib.suppress(Exception):  # whatever unpickling spoilt bytes may raise
                code = place.load_overload(signature, target_context)
                if code is not None:
                    return code
        return None

    def kept(self, target_context: Any) -> list[Any]:
        """The signatures for which this source's code for this processor is kept."""
        codegen = target_context.codegen()
        found: dict[Any, None] = {}
        for place in self._places:
            with contextlib.suppress(Exception):  # spoilt bytes
                keys = list(place._cache_file._load_index())
                found |= {key[0]: None for key in keys if key == place._index_key(key[0], codegen)}
        return list(found)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep compiled code, if that can be done."""
        if self._own is not None:
            with contextlib.suppress(OSError, EOFError, pickle.PickleError):
                self._own.save_overload(signature, data)


def _in_folder(cache: Any, folder: Path) -> Any:
    """The same cache with its files in a folder."""
    there = copy.copy(cache)
    there._cache_path = str(folder)
    index: Any = numba.core.caching.IndexDataCacheFile
    there._cache_file = index(str(folder), cache._impl.filename_base, "")
    return there


def code_folder(source: Path) -> CodeFolder:
    """The folders for the code compiled from this file.

    Their name holds a hash of numba's version and of all source texts that are compiled into the
    code: see `compiled_sources`.
    """
    name = f"{source.stem}-{_key_of(compiled_sources(source), numba.__version__)}"
    base = _cache_base()
    with contextlib.suppress(OSError):  # no disk space
        if base is not None:
            (base / name).mkdir(exist_ok=True)
            return CodeFolder(base / name, SHIPPED / name)
    return CodeFolder(None, SHIPPED / name)


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
