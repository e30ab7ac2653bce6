"""What a servo keeps without power: which rows those are, and their values on the wire."""

from __future__ import annotations

from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.errors import ProtocolError
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.table import Answer, unknown_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.family import Family
    from lss_motion.protocol.table import Row

_FIRST: Final = ("G", "AR")
"""Written before the others: G before O (FACTS.md R10), and AR before what is a pulse within it."""


@cache
def storable(family: Family) -> Mapping[str, Row]:
    """Return the rows that can be configured, by name, in the order in which to write them.

    Without the id, which names the servo, and without rows that say the same in another unit.
    """
    rows = [
        row
        for row in FAMILY_TABLES[family].rows
        if row.configs and row.mirrors is None and row.name != "ID"
    ]
    rows.sort(key=lambda row: row.name not in _FIRST)
    return MappingProxyType({row.name: row for row in rows})


def stored_wire(family: Family, name: str, value: float | None) -> int | None:
    """Return a stored value as it is on the wire; None, for a first position only: there is none.

    Raises ProtocolError for what the family does not store, or not with this value, with what is
    allowed.
    """
    rows = storable(family)
    if name not in rows:
        raise ProtocolError(unknown_text(name, rows, f"setting that {family} stores"))
    row = rows[name]
    if value is None:
        if row.answer is not Answer.DISABLED:
            raise ProtocolError(f"{name} has no DIS: {row.allowed()}")
        return None
    wire = make_command(family, 0, row.configs[0], value).value
    assert isinstance(wire, int)
    return wire
