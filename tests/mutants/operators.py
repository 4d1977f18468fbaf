"""Small mistakes that people make, and the places in a source where they can be made."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["KINDS", "Mutation", "mutated", "mutations"]

KINDS = ("comparison", "arithmetic", "constant", "sign", "axes", "off by one", "dropped", "condition", "call")
"""What the mistakes are about, in the order in which they take turns."""

_COMPARED = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
_COMPARISONS = re.compile(r"<=|>=|==|!=|<|>")
_COUNTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Mod: "*", ast.Pow: "*"}
_OPERATORS = re.compile(r"\*\*|//|[-+*/%]")
_CALLS = {
    **{"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin"},
    **{"floor": "ceil", "ceil": "floor", "sin": "cos", "cos": "sin", "any": "all", "all": "any", "mean": "sum"},
    **{"sum": "max", "sqrt": "abs", "rint": "floor", "sorted": "list", "flatnonzero": "argsort", "median": "max"},
}

_TEXT = (ast.Raise, ast.Assert, ast.JoinedStr, ast.FormattedValue)
"""What only people read is left alone."""


@dataclass(frozen=True)
class Mutation:
    """One mistake in a source: bytes ``start`` to ``stop`` become ``after``."""

    kind: str
    function: str
    line: int
    start: int
    stop: int
    before: str
    after: str


def mutated(source: bytes, mutation: Mutation) -> bytes:
    """Return the source with a mistake."""
    return source[: mutation.start] + mutation.after.encode() + source[mutation.stop :]


def mutations(source: bytes) -> list[Mutation]:
    """Return every mistake that can be made in the functions of a source, in order."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Mutation] = []
    for function, node in _nodes(ast.parse(source)):
        for kind, start, stop, after in _mistakes(node, source, starts):
            before = source[start:stop].decode()
            if before != after:
                found.append(Mutation(kind, function, source.count(b"\n", 0, start) + 1, start, stop, before, after))
    return sorted(set(found), key=lambda one: (one.start, one.stop, one.kind, one.after))


def _nodes(tree: ast.AST, function: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Yield the nodes of function bodies with the function's name: no messages, docstrings, types or decorators."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, _TEXT):
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue
            inside = function
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inside = f"{function}.{child.name}" if function else child.name
            elif function and not isinstance(tree, ast.ClassDef):
                yield function, child
            if isinstance(child, ast.ClassDef) or inside or isinstance(child, ast.stmt):
                yield from _nodes(child, inside)


def _mistakes(node: ast.AST, source: bytes, starts: list[int]) -> Iterator[tuple[str, int, int, str]]:
    """Yield kind, start, stop and replacement of each mistake in one node."""

    def span(part: ast.AST) -> tuple[int, int]:
        line, column = part.lineno, part.col_offset  # type: ignore[attr-defined]
        end_line, end_column = part.end_lineno, part.end_col_offset  # type: ignore[attr-defined]
        return starts[line - 1] + column, starts[end_line - 1] + end_column

    def text(part: ast.AST) -> str:
        start, stop = span(part)
        return source[start:stop].decode()

    def between(left: ast.AST, right: ast.AST, pattern: re.Pattern[str], after: str) -> Iterator[tuple[int, int, str]]:
        start, stop = span(left)[1], span(right)[0]
        hit = pattern.search(source[start:stop].decode())
        if hit is not None:
            yield start + hit.start(), start + hit.end(), after

    match node:
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARED:
            for change in between(left, right, _COMPARISONS, _COMPARED[type(op)]):
                yield "comparison", *change
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _COUNTED and not _is_text(left, right):
            for change in between(left, right, _OPERATORS, _COUNTED[type(op)]):
                yield "arithmetic", *change
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield "sign", *span(node), text(operand)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "condition", *span(node), f"({text(operand)})"
        case ast.Constant(value=value) if type(value) in (int, float):
            yield "constant", *span(node), str(value + 1 if isinstance(value, int) else 2 * value or 1.0)
        case ast.Tuple(elts=[*_, ast.Name() as one, ast.Name() as other]) if _is_value(one) and _is_value(other):
            start, stop = span(one)[0], span(other)[1]
            middle = source[span(one)[1] : span(other)[0]].decode()
            yield "axes", start, stop, f"{text(other)}{middle}{text(one)}"
        case ast.keyword(arg="axis", value=ast.Constant(value=int(axis)) as value):
            yield "axes", *span(value), "0" if axis else "1"
        case ast.Slice(upper=ast.expr() as upper):
            yield "off by one", *span(upper), f"{text(upper)} + 1"
        case ast.Call(func=ast.Name(id="range"), args=[*_, last]):
            yield "off by one", *span(last), f"({text(last)}) - 1"
        case ast.Call(func=ast.Name(id=name) as called) if name in _CALLS:
            yield "call", *span(called), _CALLS[name]
        case ast.Call(func=ast.Attribute(attr=name) as called) if name in _CALLS:
            stop = span(called)[1]
            yield "call", stop - len(name), stop, _CALLS[name]
        case ast.AugAssign() | ast.Expr(value=ast.Call()):
            yield "dropped", *span(node), "pass"
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
            if not isinstance(test, ast.Compare | ast.UnaryOp | ast.Constant):
                yield "condition", *span(test), f"not ({text(test)})"
        case ast.BoolOp(op=op, values=[left, right]):
            pattern, after = (re.compile("and"), "or") if isinstance(op, ast.And) else (re.compile("or"), "and")
            for change in between(left, right, pattern, after):
                yield "condition", *change


def _is_value(node: ast.Name) -> bool:
    """Return whether a name is that of a value that is used: neither a class nor an unused name."""
    return node.id[0].islower()


def _is_text(*nodes: ast.expr) -> bool:
    return any(
        isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))
        for node in nodes
    )
