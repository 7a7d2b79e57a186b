"""The one family of exceptions that ovmot raises on purpose."""

from pathlib import Path

from yaml import YAMLError


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


def yaml_problem(error: YAMLError) -> tuple[str, int | None]:
    """What is wrong with a text that is no YAML, in one line, and the row (1-based) if known."""
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error)
    row = None if mark is None else int(mark.line) + 1
    return f"not valid YAML: {' '.join(problem.split())}", row
