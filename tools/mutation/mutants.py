"""Makes the mutants of one module: the same program with one thing changed that a test must see.

Left alone are what no test should repeat: docstrings, annotations, decorators, `assert`s (they
state what cannot happen), f-strings and the arguments of `raise` (messages for people).
"""

from __future__ import annotations

import ast
import random
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import CodeType

_COMPARISONS: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_OPERATORS: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_CALLS: Final = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "minimum": "maximum",
    "maximum": "minimum",
    "argmin": "argmax",
    "argmax": "argmin",
    "ceil": "floor",
    "floor": "ceil",
}
AROUND_CHARS: Final = 40
"""What a name shows before and after the change."""
_DROPPED: Final = (ast.Expr, ast.Raise, ast.AugAssign, ast.Continue, ast.Break)
_BLOCKS: Final = ("body", "orelse", "handlers", "finalbody", "cases")
_UNTOUCHED_FIELDS: Final = ("annotation", "returns", "decorator_list", "type_params")
_UNTOUCHED: Final = (ast.JoinedStr, ast.Assert, ast.Import, ast.ImportFrom)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One changed program. `name` says where and what, and stays the same when lines move."""

    name: str
    line: int
    code: CodeType


def mutants_of(source: str, filename: str) -> list[Mutant]:
    """Return every mutant of a module, compiled, in order of the lines."""
    tree = ast.parse(source, filename)
    seen: Counter[str] = Counter()
    made: list[Mutant] = []
    for place, statement, parent, field, index, new in _changes(tree, (), tree):
        before = _header(statement)
        old = _put(parent, field, index, ast.fix_missing_locations(new))
        after = _header(new if old is statement else statement)
        name = f"{'.'.join(place) or 'module'}: {_difference(before, after)}"
        seen[name] += 1
        if seen[name] > 1:
            name += f" ({seen[name]})"
        line = getattr(old, "lineno", getattr(statement, "lineno", 0))
        made.append(Mutant(name=name, line=line, code=compile(tree, filename, "exec")))
        _put(parent, field, index, old)
    return sorted(made, key=lambda mutant: mutant.line)


def sampled(mutants: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """Return `count` of them, or all if they are fewer: one of each of so many equal stretches."""
    if count >= len(mutants):
        return list(mutants)
    ends = [index * len(mutants) // count for index in range(count + 1)]
    choice = random.Random(seed).choice  # noqa: S311  (no secret)
    return [choice(mutants[first:end]) for first, end in pairwise(ends)]


_Change = tuple[tuple[str, ...], ast.AST, ast.AST, str, int | None, ast.AST]


def _changes(node: ast.AST, place: tuple[str, ...], statement: ast.AST) -> Iterator[_Change]:
    """Yield `(place, statement, parent, field, index, new node)` for all below `node`."""
    for field, index, child in _children(node):
        inside = child if isinstance(child, ast.stmt) else statement
        for new in _replacements(child, field):
            yield place, inside, node, field, index, ast.copy_location(new, child)
        named = isinstance(child, ast.FunctionDef | ast.ClassDef)
        yield from _changes(child, (*place, child.name) if named else place, inside)


def _children(node: ast.AST) -> Iterator[tuple[str, int | None, ast.AST]]:
    """Yield field, index and node of what may be changed below `node`."""
    for field, value in ast.iter_fields(node):
        if field in _UNTOUCHED_FIELDS or (
            isinstance(node, ast.Raise) and field in {"exc", "cause"}
        ):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else ((None, value),):
            if isinstance(child, ast.AST) and not _is_untouched(child):
                yield field, index, child


def _is_untouched(node: ast.AST) -> bool:
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return True
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return is_text or isinstance(node, _UNTOUCHED)


def _replacements(node: ast.AST, field: str) -> Iterator[ast.AST]:
    """Yield what may stand in place of one node."""
    if isinstance(node, ast.expr):
        yield from _other_expressions(node)
    if isinstance(node, ast.Name | ast.Call | ast.Attribute) and field in {"test", "ifs"}:
        yield ast.UnaryOp(ast.Not(), node)
    if isinstance(node, ast.AugAssign) and type(node.op) in _OPERATORS:
        yield ast.AugAssign(node.target, _OPERATORS[type(node.op)](), node.value)
    if isinstance(node, ast.Return) and node.value is not None:
        if not _is_nothing(node.value):
            yield ast.Return(ast.Constant(None))
    elif isinstance(node, _DROPPED) or _is_kept_assignment(node):
        yield ast.Pass()


def _is_nothing(node: ast.expr) -> bool:
    """Return whether a test of its truth could not tell it from None, nor should."""
    return isinstance(node, ast.Constant) and (node.value is None or node.value is False)


def _other_expressions(node: ast.expr) -> Iterator[ast.expr]:
    match node:
        case ast.Compare():
            for index, op in enumerate(node.ops):
                for other in _COMPARISONS[type(op)]:
                    ops = [*node.ops[:index], other(), *node.ops[index + 1 :]]
                    yield ast.Compare(node.left, ops, node.comparators)
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.BinOp() if type(node.op) in _OPERATORS and not _is_format(node):
            yield ast.BinOp(node.left, _OPERATORS[type(node.op)](), node.right)
        case ast.Call(func=ast.Name(id=called)) if called in _CALLS:
            yield ast.Call(ast.Name(_CALLS[called], ast.Load()), node.args, node.keywords)
        case ast.Call(func=ast.Attribute(attr=called) as func) if called in _CALLS:
            other_way = ast.Attribute(func.value, _CALLS[called], ast.Load())
            yield ast.Call(other_way, node.args, node.keywords)
        case ast.Constant() if (value := _another(node.value)) is not None:
            yield ast.Constant(value)


def _is_kept_assignment(node: ast.AST) -> bool:
    """Return whether a statement changes something that others see."""
    if not isinstance(node, ast.Assign):
        return False
    return any(isinstance(target, ast.Attribute | ast.Subscript) for target in node.targets)


def _is_format(node: ast.BinOp) -> bool:
    is_text = isinstance(node.left, ast.Constant) and isinstance(node.left.value, str | bytes)
    return is_text and isinstance(node.op, ast.Mod)


def _another(value: object) -> bool | float | str | bytes | None:
    match value:
        case bool():
            return not value
        case int() | float():
            return value * 2 if abs(value) > 1 else value + 1
        case str():
            return f"X{value}"
        case bytes():
            return b"X" + value
        case _:
            return None


def _put(parent: ast.AST, field: str, index: int | None, new: ast.AST) -> ast.AST:
    """Put a node where another is; return that one."""
    if index is None:
        old: ast.AST = getattr(parent, field)
        setattr(parent, field, new)
        return old
    nodes: list[ast.AST] = getattr(parent, field)
    nodes[index], old = new, nodes[index]
    return old


def _difference(before: str, after: str) -> str:
    """Return what differs, and enough around it to find it."""
    alike = _alike(before, after)
    behind = _alike(before[alike:][::-1], after[alike:][::-1])
    start = max(0, alike - AROUND_CHARS)
    cut = [
        ("…" if start else "")
        + text[start : len(text) - behind + AROUND_CHARS]
        + ("…" if behind > AROUND_CHARS else "")
        for text in (before, after)
    ]
    return f"`{cut[0]}` -> `{cut[1]}`"


def _alike(one: str, other: str) -> int:
    """Return how many characters two texts have in common at their beginning."""
    pairs = enumerate(zip(one, other, strict=False))
    return next((index for index, (a, b) in pairs if a != b), min(len(one), len(other)))


def _header(statement: ast.AST) -> str:
    """Return a statement in one line, without the block below it."""
    names = set(getattr(statement, "_fields", ())) & set(_BLOCKS)
    bare = {name: [] for name in names} | ({"body": [ast.Pass()]} if "body" in names else {})
    fields = dict(ast.iter_fields(statement)) | bare
    text = ast.unparse(ast.fix_missing_locations(type(statement)(**fields)))
    lines = [line for line in text.splitlines() if not line.startswith("@")]
    return lines[0].removesuffix(": pass") if lines else ""
