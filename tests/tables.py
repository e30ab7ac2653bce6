"""Tables of tests: one row a behaviour, and a title that a failure shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Mapping


def titled(names: str, rows: Mapping[str, Any]) -> pytest.MarkDecorator:
    """Run a test once for each row: title → the values of `names`."""
    return pytest.mark.parametrize(names, list(rows.values()), ids=list(rows))
