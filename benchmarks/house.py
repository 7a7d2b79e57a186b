"""How the house stands: numeric constants, settings, long and short files, long functions.

    python benchmarks/house.py [ROOT]

A numeric constant is a module-level assignment in capitals whose value holds a number; each name
counts. Not counted: the layout of a vector (slices, sizes and indices of coordinates), codes of
states, what follows from other constants, a literal dictionary.
"""

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

CORE = ("frontend", "segmentation", "vio", "initialization")
LAYOUT = frozenset(
    {"THETA", "POSITION", "VELOCITY", "GYRO_BIAS", "ACCEL_BIAS", "TIME_OFFSET", "N_IMU", "N_BASE",
     "CLONE_SIZE", "KEYFRAME_SIZE", "BIAS_OF_GYRO", "BIAS_OF_ACCEL", "OFFSET", "YAW_RATE",
     "N_STATE", "NO_ANCHOR", "NOT_KEPT", "LEFT", "RIGHT", "LOST", "TRACKED", "ALIGNED", "POSE",
     "POINT", "VIEW", "BIAS", "UPPER", "FOCAL_AND_CENTER", "VELOCITY_DOF", "NO_IMAGE"}
)  # fmt: skip
SHORT_LINES, LONG_LINES, LONG_FUNCTION = 40, 350, 50


@dataclass(frozen=True, slots=True)
class Function:
    """A function or method: where it is, and how many lines it has without its docstring."""

    where: str
    lines: int


def constants(path: Path) -> list[str]:
    """Names of the numeric constants of a module."""
    found: list[str] = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            target, value = node.target, node.value
        else:
            continue
        names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
        if isinstance(value, ast.Dict) or not _holds_a_number(value) or _follows(value):
            continue
        found += [n for n in names if n.isupper() and n.strip("_") not in LAYOUT]
    return found


def _holds_a_number(value: ast.expr) -> bool:
    return any(
        isinstance(n, ast.Constant)
        and isinstance(n.value, int | float)
        and not isinstance(n.value, bool)
        for n in ast.walk(value)
    )


def _follows(value: ast.expr) -> bool:
    """Is a value computed from another constant?"""
    return any(isinstance(n, ast.Name) and n.id.isupper() for n in ast.walk(value))


def functions(path: Path, root: Path) -> Iterator[Function]:
    """All functions of a module with their length."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            last = node.end_lineno or node.lineno
            where = f"{path.relative_to(root)}:{node.lineno} {node.name}"
            yield Function(where, last - body[0].lineno + 1)


def count_constants(package: Path) -> dict[str, int]:
    """Numeric constants of each stage and of `physics.py`."""
    stages = (*CORE, "objects")
    counts = {s: sum(len(constants(p)) for p in sorted((package / s).glob("*.py"))) for s in stages}
    return counts | {"physics.py": len(constants(package / "physics.py"))}


def lengths(package: Path) -> dict[str, int]:
    """Lines of every module, `__init__.py` left out."""
    paths = (p for p in sorted(package.rglob("*.py")) if p.name not in ("__init__.py",))
    return {
        str(p.relative_to(package)): len(p.read_text(encoding="utf-8").splitlines()) for p in paths
    }


def main(root: Path) -> None:
    """Print the figures of a checkout."""
    from ovmot.settings import describe_settings

    package = root / "src" / "ovmot"
    counts = count_constants(package)
    outside = sum(n for stage, n in counts.items() if stage != "objects")
    print(f"numeric constants: {counts}; outside objects {outside}")
    print(f"settings: {len(list(describe_settings()))}")
    lines = lengths(package)
    print("under 40 lines:", {name: n for name, n in lines.items() if n < SHORT_LINES})
    print("over 350 lines:", {name: n for name, n in lines.items() if n > LONG_LINES})
    every = [f for p in package.rglob("*.py") for f in functions(p, package)]
    longest = sorted(every, key=lambda f: -f.lines)
    print("functions over 50 lines:", [(f.where, f.lines) for f in longest if f.lines > 50])
    print("longest file and function:", max(lines.items(), key=lambda x: x[1]), longest[0])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1])
