"""What a servo remembers: its EEPROM and its session, by the rows of its family's table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.protocol.constants import DEG_S_PER_RPM

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.table import FamilyTable, Row


class Settings:
    """Wire values by the name of their row. A setting in another unit writes the row it mirrors."""

    def __init__(
        self,
        table: FamilyTable,
        firmware: int,
        factory: Mapping[str, int],
        eeprom: Mapping[str, int],
    ) -> None:
        self.table = table
        self._rows = {row.name: row for row in table.rows if not row.is_modifier}
        self._firmware = firmware
        self._factory: dict[str, int | None] = {
            row.name: factory.get(row.name, row.default)
            for row in table.rows
            if (row.actions or row.configs) and row.mirrors is None
        }
        self.eeprom = {**self._factory, **eeprom}
        self.session = dict(self.eeprom)

    def restart(self) -> None:
        self.session = dict(self.eeprom)

    def restore_factory(self) -> None:
        """Forget every configuration but the id, which no document says to be lost or kept.

        Assumed: a servo that lost its id could not be told apart from its neighbours.
        """
        self.eeprom = {**self._factory, "ID": self.eeprom.get("ID")}

    def row(self, name: str) -> Row:
        return self._rows[name]

    def factory(self, name: str) -> int:
        return self._factory.get(name) or 0

    def number(self, name: str) -> int:
        """Return a session value as it is on the wire; 0 where there is none."""
        return self.session.get(name) or 0

    def physical(self, name: str) -> float:
        """Return a session value in the physical unit of its row."""
        return self.row(name).physical(self.number(name))

    def write(self, row: Row, value: int | None, *, is_config: bool) -> bool:
        """Store a value as the servo would; return whether it was taken."""
        if value is not None:
            kept = row.kept(value)
            too_new = row.choices is not None and row.choices.get(value, 0) > self._firmware
            if kept is None or too_new:
                return False
            value = kept
        if row.mirrors is not None:
            row, value = self.row(row.mirrors), self._mirrored(row, value)
        if row.name == "SD" and value is not None:
            value = min(value, self._factory["SD"] or value)
        if is_config:
            self.eeprom[row.name] = value
        self.session[row.name] = value
        return True

    def read(self, row: Row, *, is_configured: bool) -> int | None:
        """Return what a query of this row answers."""
        values = self.eeprom if is_configured or not row.sets_session else self.session
        if row.mirrors is None:
            return values.get(row.name)
        stored = self.row(row.mirrors)
        wire = values.get(stored.name)
        return None if wire is None else round(stored.physical(wire) / DEG_S_PER_RPM)

    def _mirrored(self, row: Row, value: int | None) -> int | None:
        assert row.mirrors is not None
        if value is None:
            return None
        return self.row(row.mirrors).wire(row.physical(value) * DEG_S_PER_RPM)
