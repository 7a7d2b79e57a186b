"""The one family of exceptions that ovmot raises on purpose."""

from pathlib import Path


class OvmotError(Exception):
    """Base of every error whose message is meant for the user as it stands."""


class InputError(OvmotError):
    """A file, folder or setting that the user gave is wrong; the command line exits with 2."""

    @classmethod
    def at(
        cls, path: Path | str, problem: str, remedy: str = "", *, row: int | None = None
    ) -> "InputError":
        """One line: which file, which row (1-based), what is wrong, what to do about it."""
        place = f"{path}" if row is None else f"{path}, row {row}"
        return cls(f"{place}: {problem}" + (f"; {remedy}" if remedy else ""))


class CalibrationError(InputError):
    """A calibration file that cannot be read or that describes an impossible camera."""


class DatasetError(InputError):
    """A recorded sequence that cannot be read, or not any further."""


class InitializationError(OvmotError):
    """No initial state by these frames, and why; more frames may give one."""


class SettingsWarning(UserWarning):
    """A setting is accepted, but not under this name any more."""


def is_interrupt(error: BaseException) -> bool:
    """Is it Ctrl-C, or an error that a library has made of it?

    numba, for one, raises `SystemError` where Ctrl-C falls into the loading of a kernel.
    """
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        if isinstance(cause, KeyboardInterrupt):
            return True
        seen.add(id(cause))
        cause = cause.__cause__ or cause.__context__
    return False
