"""How many numbers the objects' stage has of its own, beside the facts of `physics.py`."""

import ast
from collections.abc import Iterator
from pathlib import Path

import ovmot.objects

MOST = 59
NO_NUMBERS = {
    "N_BODY", "VELOCITY", "_LEVEL", "_POSE", "_HEIGHT", "_NO_LABEL", "_NEVER",
    "UNSEEN", "STEREO", "LEFT", "REFUSED",
}  # fmt: skip
"""Layouts of states and boxes, names of cases, and what stands for nothing."""
COUNTS = {"gate", "np.zeros", "np.empty", "np.eye"}
"""Functions whose first argument is a number of dimensions."""


def numbers_of(source: str) -> list[str]:
    """Names of a module's numbers: assignments with a number in them, and arguments of calls."""
    return [
        name
        for statement in ast.parse(source).body
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None
        for name, value in parts_of(statement, statement.value)
        if name not in NO_NUMBERS and has_number(value)
    ]


def parts_of(
    statement: ast.Assign | ast.AnnAssign, value: ast.expr
) -> Iterator[tuple[str, ast.expr]]:
    """What a statement assigns, one by one: values of names, and of the fields of a tuple."""
    target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
    name = ast.unparse(target)
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        yield from zip(map(ast.unparse, target.elts), value.elts, strict=True)
    elif isinstance(value, ast.Call) and value.keywords:
        yield from ((f"{name}[{k}]", part) for k, part in enumerate(value.args))
        yield from ((f"{name}.{part.arg}", part.value) for part in value.keywords)
    else:
        yield name, value


def has_number(expression: ast.AST) -> bool:
    """Is there a number in an expression? Indices and numbers of dimensions are none."""
    if isinstance(expression, ast.Subscript):
        return has_number(expression.value)
    if isinstance(expression, ast.Call) and ast.unparse(expression.func) in COUNTS:
        return any(has_number(part) for part in expression.args[1:])
    if isinstance(expression, ast.Constant):
        return type(expression.value) in (int, float)
    return any(has_number(part) for part in ast.iter_child_nodes(expression))


def test_numbers_are_found() -> None:
    source = "\n".join([
        "A: float = -0.5", "_B = gate(3, 0.99)", "C, D = 1.0, E[0]", "_NONE = np.empty(0)",
        "F = Box(1, wide=2.0 * A, high=A)", "G = True", "def h():\n    return 2.0",
    ])  # fmt: skip
    assert numbers_of(source) == ["A", "_B", "C", "F[0]", "F.wide"]


def test_there_are_few_numbers() -> None:
    """A new one is a fact with its source (then it is one of `physics.py`), or a probability."""
    files = sorted(Path(next(iter(ovmot.objects.__path__))).glob("*.py"))
    found = [f"{f.stem}.{name}" for f in files for name in numbers_of(f.read_text("utf-8"))]
    assert len(found) <= MOST, "\n".join(found)
