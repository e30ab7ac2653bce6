"""The report of a run with many shows: its totals, and the last shows one by one.

Its size does not grow with the run. Who needs every show takes each `events.ShowOver` when it
comes.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, to_builtins

from lss_motion.playing.player.events import ShowOver, Warned
from lss_motion.playing.report import bus_report
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.playing.player.events import Event, Faulted, ShowSummary
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import BusReport
    from lss_motion.playing.sound_choice import SoundReport

STAGE_SCHEMA_VERSION: Final = 1
SHOWS_KEPT: Final = 200
"""So many of the last shows are in the report one by one."""
WARNINGS_KEPT: Final = 200
NAMES_MAX: Final = 500
"""Shows with more names than this are counted together: a stage may be given new ones for ever."""
OTHER_NAMES: Final = "(others)"


@dataclass(slots=True)
class ShowTotals:
    """All times that one show was played."""

    plays: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    lasted_s: float = 0.0
    """Run time of all of them together."""
    commands: int = 0
    missed: int = 0
    late_max_us: int = 0
    error_max_deg: float = 0.0
    error_max_joint: str = ""

    def add(self, one: ShowSummary) -> None:
        """Count a show that is over."""
        self.plays += 1
        self.outcomes[one.outcome] += 1
        self.lasted_s += s_from_ns(one.ended_ns - one.began_ns)
        self.commands += one.commands
        self.missed += one.missed
        self.late_max_us = max(self.late_max_us, one.late_max_us)
        for name, joint in one.joints.items():
            if joint.error_max_deg > self.error_max_deg:
                self.error_max_deg, self.error_max_joint = joint.error_max_deg, name


class StageReport(Struct, frozen=True, kw_only=True):
    """The numbers of one run with many shows."""

    schema: int = STAGE_SCHEMA_VERSION
    robot: str
    simulated: bool
    outcome: str
    """`stopped`, `fault` or `lost`."""
    run_s: float
    buses: Mapping[str, BusReport]
    totals: Mapping[str, ShowTotals]
    """By the name of the show."""
    last_shows: tuple[ShowSummary, ...]
    faults: tuple[Faulted, ...]
    warnings: tuple[str, ...]
    """The last ones, each once."""
    sound: SoundReport | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the report as an object for `json.dumps`."""
        found: dict[str, Any] = to_builtins(self)
        for fault in found["faults"]:
            del fault["type"]
        return found


class Ledger:
    """Keeps what a report needs, while the events of a run come in."""

    def __init__(self) -> None:
        self.totals: dict[str, ShowTotals] = {}
        self.last_shows: deque[ShowSummary] = deque(maxlen=SHOWS_KEPT)
        self._warnings: dict[str, None] = {}

    def note(self, event: Event) -> None:
        """Keep what an event tells, if it tells anything."""
        if isinstance(event, Warned):
            self._warnings.pop(event.text, None)
            self._warnings[event.text] = None
            if len(self._warnings) > WARNINGS_KEPT:
                del self._warnings[next(iter(self._warnings))]
        elif isinstance(event, ShowOver):
            one = event.summary
            is_known = one.name in self.totals or len(self.totals) < NAMES_MAX
            name = one.name if is_known else OTHER_NAMES
            self.totals.setdefault(name, ShowTotals()).add(one)
            self.last_shows.append(one)

    def report(
        self,
        player: Player,
        *,
        run_s: float,
        is_simulated: bool,
        outcome: str,
        sound: SoundReport | None,
    ) -> StageReport:
        """Return the report of a run that has ended."""
        return StageReport(
            robot=player.robot.name,
            simulated=is_simulated,
            outcome=outcome,
            run_s=round(run_s, 3),
            buses={name: bus_report(player, name, run_s) for name in player.lines},
            totals=dict(self.totals),
            last_shows=tuple(self.last_shows),
            faults=tuple(player.faults),
            warnings=tuple(self._warnings),
            sound=sound,
        )
