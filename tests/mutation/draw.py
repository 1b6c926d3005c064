"""Small defects of one statement each: what every place of the product can be changed to.

A place is a comparison, an operator, a number, a returned value, a condition or a call on a line of its own. Each has
one change, so that places are drawn alike. Texts, annotations and generated code are left alone.
"""

import ast
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PACKAGES = ("agents", "shared", "schemas")
SWAPS: dict[type[ast.AST], Any] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


@dataclass(frozen=True)
class Mutant:
    """One change of one place; lines count from 1, columns in bytes from 0."""

    path: str
    scope: str
    line: int
    column: int
    end_line: int
    end_column: int
    was: str
    becomes: str


def draw(root: Path, count: int, seed: int) -> list[Mutant]:
    """So many mutants of the product below `root`, drawn by a seed, in the order of their places."""
    everywhere = [each for package in PACKAGES for path in _files(root / package) for each in mutants(path, root)]
    return sorted(random.Random(seed).sample(everywhere, count), key=lambda each: (each.path, each.line, each.column))


def mutants(path: Path, root: Path) -> Iterator[Mutant]:
    """All changes of one file, one for each place."""
    source = path.read_bytes()
    lines = source.splitlines(keepends=True)
    for node, scope in _places(ast.parse(source), "<module>"):
        becomes = _changed(node)
        if becomes is None:
            continue
        assert isinstance(node, ast.expr | ast.stmt) and node.end_lineno and node.end_col_offset is not None
        span = (node.lineno, node.col_offset, node.end_lineno, node.end_col_offset)
        yield Mutant(str(path.relative_to(root)), scope, *span, _cut(lines, *span), becomes)


def applied(mutant: Mutant, source: bytes) -> bytes:
    """A file's text with the mutant in it; ValueError where the place holds something else by now."""
    lines = source.splitlines(keepends=True)
    first, last = mutant.line - 1, mutant.end_line - 1
    if last >= len(lines) or _cut(lines, mutant.line, mutant.column, mutant.end_line, mutant.end_column) != mutant.was:
        raise ValueError(f"{mutant.path}:{mutant.line} no longer holds `{mutant.was}`: draw anew")
    head, tail = lines[first][: mutant.column], lines[last][mutant.end_column :]
    return b"".join([*lines[:first], head + mutant.becomes.encode() + tail, *lines[last + 1 :]])


def _files(package: Path) -> list[Path]:
    return sorted(path for path in package.rglob("*.py") if "generated" not in path.parts)


def _cut(lines: list[bytes], line: int, column: int, end_line: int, end_column: int) -> str:
    if line == end_line:
        return lines[line - 1][column:end_column].decode()
    middle = lines[line : end_line - 1]
    return b"".join([lines[line - 1][column:], *middle, lines[end_line - 1][:end_column]]).decode()


def _places(node: ast.AST, scope: str) -> Iterator[tuple[ast.AST, str]]:
    """Every node whose place in the text is known and that computes, with the function or class that it stands in."""
    for name, field in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "type_params"}:
            continue
        for child in field if isinstance(field, list) else [field]:
            # Python 3.11 does not say where in an f-string its parts are
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr):
                continue
            named = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            inner = (child.name if scope == "<module>" else f"{scope}.{child.name}") if named else scope
            yield child, inner
            yield from _places(child, inner)


def _changed(node: ast.AST) -> str | None:
    """What stands in a node's place, or None where it has no change."""
    match node:
        case ast.Compare(ops=[op]) if type(op) in SWAPS:
            new: ast.expr = ast.Compare(node.left, [_swapped(op)], node.comparators)
        case ast.BinOp() if type(node.op) in SWAPS:
            new = ast.BinOp(node.left, _swapped(node.op), node.right)
        case ast.BoolOp():
            new = ast.BoolOp(_swapped(node.op), node.values)
        case ast.UnaryOp(op=ast.Not()):
            new = node.operand
        case ast.Constant(value=bool()):
            new = ast.Constant(not node.value)
        case ast.Constant(value=int() | float() as number):
            new = ast.Constant(number + 1)
        case ast.Return(value=ast.expr()) if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            return "return None"
        case ast.Expr(value=ast.Call()) | ast.Raise():
            return "pass"
        case ast.IfExp():
            new = ast.IfExp(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)
        case _:
            return None
    return f"({ast.unparse(new)})"


def _swapped(op: ast.AST) -> Any:
    return SWAPS[type(op)]()
