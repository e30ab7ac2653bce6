"""Times of day: cron expressions and quiet hours on a wall clock that may be set at any time.

The wall clock jumps: NTP sets it after the start of a computer without a battery, and summer time
begins and ends. `CronClock` finds which expressions are due so that each fires once:

- It goes through the minutes of UTC, which summer time does not change, and never through one
  again. A clock that is set back fires nothing before it is where it was; set back by more than
  `CORRECTED`, it counts as a corrected clock, and the new time holds (as cron of Debian does).
- A clock that is set forward fires what was skipped within `LATE`, not the cues of hours.
- An expression with a fixed hour and minute in the hour that summer time skips fires at its end,
  and in the hour that winter time repeats fires once. Others (`*/10 * * * *`) go by the minutes.
"""

from __future__ import annotations

from datetime import UTC, datetime, time, timedelta, tzinfo
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, install_command

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

MINUTE: Final = timedelta(minutes=1)

CORRECTED: Final = timedelta(hours=3)
"""cron(8) of Debian: a change of more than three hours is a correction of the clock."""

LATE: Final = timedelta(minutes=5)
"""Chosen: a cue this late still belongs to its evening; an hour of cues at once does not."""

FIELDS: Final = 5


def cron_problem(text: str) -> str:
    """Return why a cron expression cannot be used; empty if it can.

    Raises `InputError` if the library for it is not installed.
    """
    try:
        from cronsim import CronSim, CronSimError
    except ImportError as error:
        raise InputError(f"times of day need a library: {install_command('stage')}") from error
    if len(text.split()) != FIELDS:
        return (
            f"has {len(text.split())} fields, not {FIELDS}: minute, hour, day, month, weekday, "
            f"such as `*/10 18-23 * * fri,sat`"
        )
    try:
        next(CronSim(text, datetime(2024, 1, 1)))  # noqa: DTZ001  any local time
    except CronSimError as error:
        return f"is no time of day: {error}; such as `*/10 18-23 * * fri,sat`"
    except StopIteration:
        return "never comes"
    return ""


def clock_time(text: str) -> time | None:
    """Return the time of day of a text such as `23:00`; None: there is none such."""
    try:
        return time.fromisoformat(text)
    except ValueError:
        return None


def is_within(now: time, spans: Iterable[tuple[time, time]]) -> bool:
    """Return whether a time of day is in one of the spans, which may go through midnight."""
    return any(
        begin <= now < end if begin <= end else now >= begin or now < end for begin, end in spans
    )


class CronClock:
    """Finds the cron expressions that are due, minute by minute."""

    def __init__(self, expressions: Iterable[str], zone: tzinfo | None = None) -> None:
        """Watch `expressions`; `zone` is that of the times, None: that of the computer."""
        self.watch(expressions, zone)
        self._until: datetime | None = None
        """The last minute, in UTC, that was gone through."""
        self._until_local: datetime | None = None
        """The latest local time that was gone through."""

    def watch(self, expressions: Iterable[str], zone: tzinfo | None) -> None:
        """Go on with other expressions."""
        self._expressions = tuple(dict.fromkeys(expressions))
        self._zone = zone

    def due(self, wall: datetime) -> tuple[list[str], str]:
        """Return the expressions that are due by `wall`, an aware time, and what was noticed.

        Each is returned once, also if several of its minutes have passed. The first call only
        notes the time.
        """
        minute = wall.astimezone(UTC).replace(second=0, microsecond=0)
        until, text = self._until, ""
        if until is None or until - minute > CORRECTED:
            if until is not None:
                text = f"the clock was set back by {until - minute}: times of day begin anew"
            self._until, self._until_local = minute, self._local(minute)
            return [], text
        if minute - until > LATE:
            text = f"the clock was set forward by {minute - until}: what was due before is left out"
            self._until = minute - LATE
            self._until_local = self._local(self._until)
        found: dict[str, None] = {}
        for passed in self._minutes(minute):
            found |= dict.fromkeys(self._due_at(passed))
        return list(found), text

    def local(self, wall: datetime) -> datetime:
        """Return the time of day of `wall`, without a zone."""
        return self._local(wall)

    def _minutes(self, minute: datetime) -> Iterator[datetime]:
        assert self._until is not None
        while self._until < minute:
            self._until += MINUTE
            yield self._until

    def _due_at(self, minute: datetime) -> Iterator[str]:
        """Yield the expressions that are due in this minute of UTC."""
        local, before = self._local(minute), self._until_local
        assert before is not None
        for expression in self._expressions:
            begin = local - MINUTE if _is_wild(expression) else before
            if begin < local and _next(expression, begin) <= local:
                yield expression
        self._until_local = max(local, before)

    def _local(self, instant: datetime) -> datetime:
        return instant.astimezone(self._zone).replace(tzinfo=None)


def _is_wild(expression: str) -> bool:
    """Return whether it has no fixed minute or hour, as cron of Debian divides them."""
    return any(field.startswith("*") for field in expression.split()[:2])


def _next(expression: str, after: datetime) -> datetime:
    from cronsim import CronSim

    return next(CronSim(expression, after), datetime.max)  # noqa: DTZ901  local times
