"""Tables of tests: one row a behaviour, and a title that a failure shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


def titled(names: str, rows: Mapping[str, Any]) -> pytest.MarkDecorator:
    """Run a test once for each row: title → the values of `names`."""
    return pytest.mark.parametrize(names, list(rows.values()), ids=list(rows))


def first_quick(rows: Iterable[Any], count: int = 1) -> list[Any]:
    """Leave all but the first rows to the slow tier."""
    quick, slow = list(rows)[:count], list(rows)[count:]
    packed = (row if isinstance(row, tuple) else (row,) for row in slow)
    return [*quick, *(pytest.param(*row, marks=pytest.mark.slow) for row in packed)]
