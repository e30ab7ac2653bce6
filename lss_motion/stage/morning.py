"""What happened in a night, from the log of a stage: for the owner in the morning.

`read_night` reads the lines of a folder; `Night` sums them up; `text_of`, `as_json` and `html_of`
show it: what played, which cue fired or was refused and why, faults, the hottest servo, the worst
error, and what to look at.
"""

from __future__ import annotations

import html
import io
import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import RECORDING_MAX_BYTES, read_data
from lss_motion.files.texts import aligned, counted
from lss_motion.stage.log import FAULT_PREFIX, PREFIX, last_written

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

NIGHT: Final = timedelta(hours=24)
"""What is summed up, back from the last line, if no time is given."""

FAULTS_MAX: Final = 200
"""Faults that are listed; all are counted."""

HOT_C: Final = 60.0
"""A servo that was this warm is named: 15 degrees below the default of temperature_max_c."""

ERROR_DEG: Final = 5.0
"""Half of the default of following_deg: a joint that was this far off is named."""


@dataclass(slots=True)
class ShowNight:
    """All times that a show was played."""

    plays: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    played_s: float = 0.0
    error_max_deg: float = 0.0
    worst: str = ""
    missed: int = 0


@dataclass(slots=True)
class CueNight:
    """What became of each trigger of a cue."""

    fired: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """How often, by reason."""
    not_played: Counter[str] = field(default_factory=Counter)
    """How often it has fired, but the player could not play its show, by reason."""


@dataclass(slots=True)
class FaultNight:
    """One fault that ended a run."""

    at: str
    text: str
    after: str = ""
    """What the stage did then."""


@dataclass(slots=True)
class Night:
    """The sum of the lines between two times."""

    begins: datetime
    ends: datetime
    shows: dict[str, ShowNight] = field(default_factory=dict)
    cues: dict[str, CueNight] = field(default_factory=dict)
    faults: list[FaultNight] = field(default_factory=list)
    fault_count: int = 0
    given_up: int = 0
    player_faults: Counter[str] = field(default_factory=Counter)
    """Faults that the player met with `on_fault`, by kind and step."""
    rests_s: dict[str, float] = field(default_factory=dict)
    """How long the figure rested, by reason."""
    connects: int = 0
    restarts: int = 0
    """How often the stage began anew: for new files, or after its process had ended."""
    hottest_c: float | None = None
    hottest: str = ""
    hottest_at: str = ""
    voltage_min_v: float | None = None
    error_max_deg: float = 0.0
    worst: str = ""
    worst_show: str = ""
    warnings: Counter[str] = field(default_factory=Counter)
    lost_lines: int = 0
    broken_lines: int = 0
    samples: list[tuple[datetime, float | None, float | None]] = field(default_factory=list)
    """Time, temperature of the hottest servo, current of all."""
    plays_at: list[datetime] = field(default_factory=list)
    dumps: tuple[str, ...] = ()
    _resting: dict[str, datetime] = field(default_factory=dict)


def read_night(folder: Path, since: datetime | None = None) -> Night:
    """Return the sum of the lines of a folder from `since` on; default: the last 24 hours of it.

    Raises `InputError` for a folder without a log. Lines that are broken are counted.
    """
    files = sorted(folder.glob(f"{PREFIX}*.jsonl"))
    if not files:
        raise InputError("has no log of a stage (stage-….jsonl)", path=folder)
    broken = Counter[str]()
    if since is None:
        last = last_written(folder)
        if last is None:
            raise InputError("has no line that can be read", path=files[-1].parent)
        since = last - NIGHT
    records = [one for file in files if _may_hold(file, since) for one in _records(file, broken)]
    if since.tzinfo is None and records:
        since = since.replace(tzinfo=records[-1][0].tzinfo)
    chosen = [(at, record) for at, record in records if at >= since]
    if not chosen:
        raise InputError(f"has no line since {since:%Y-%m-%d %H:%M}", path=folder)
    night = Night(begins=chosen[0][0], ends=chosen[-1][0], broken_lines=broken["lines"])
    before_at = night.begins
    for at, record in chosen:
        if record.get("kind") in ("begins", "must_restart"):  # No rest outlives its process.
            _change_rest(night, before_at, [])
        if record.get("kind") == "begins" and record is not chosen[0][1]:
            night.restarts += 1
        _add(night, at, record)
        before_at = at
    _change_rest(night, night.ends, [])
    night.dumps = tuple(file.name for file in sorted(folder.glob(f"{FAULT_PREFIX}*.log")))
    return night


def _may_hold(file: Path, since: datetime) -> bool:
    """Return whether a file may have lines since then, by the day in its name."""
    day = file.name.removeprefix(PREFIX)[:10]
    return day >= f"{since - timedelta(days=1):%Y-%m-%d}"


def _records(file: Path, broken: Counter[str]) -> Iterator[tuple[datetime, dict[str, Any]]]:
    for line in read_data(file, RECORDING_MAX_BYTES).splitlines():
        try:
            record = json.loads(line)
            yield datetime.fromisoformat(record["t"]), record
        except (ValueError, KeyError, TypeError):
            broken["lines"] += 1


def _add(night: Night, at: datetime, record: dict[str, Any]) -> None:
    """Add one line."""
    match record.get("kind"):
        case "fired" | "refused" | "not_played":
            _add_cue(night, record)
        case "over":
            _add_show(night, at, record)
        case "fault" | "alert" | "player_fault":
            _add_fault(night, at, record)
        case "rest":
            _change_rest(night, at, record["reasons"])
        case "connected":
            night.connects += 1
        case "sample":
            _add_sample(night, at, record)
        case "warned":
            night.warnings[record["text"]] += 1
        case "lost":
            night.lost_lines += record["count"]


def _add_cue(night: Night, record: dict[str, Any]) -> None:
    cue = night.cues.setdefault(record["cue"], CueNight())
    if record["kind"] == "fired":
        cue.fired += 1
    elif record["kind"] == "not_played":
        cue.not_played[_plain(record["reason"])] += 1
    else:
        cue.refused[_plain(record["reason"])] += record["count"]


def _add_fault(night: Night, at: datetime, record: dict[str, Any]) -> None:
    if record["kind"] == "player_fault":
        night.player_faults[f"{record['cause']}: {record['step']}"] += 1
    elif record["kind"] == "fault":
        night.fault_count += 1
        if len(night.faults) < FAULTS_MAX:
            night.faults.append(FaultNight(f"{at:%H:%M:%S}", record["text"]))
    else:
        night.given_up += record["alert"] == "given_up"
        if night.faults:
            night.faults[-1].after = record["text"].rpartition("; ")[2]


def _plain(reason: str) -> str:
    """Return a reason without what differs each time, so that equal ones are counted together."""
    return reason.partition(",")[0].partition(" (")[0]


def _add_show(night: Night, at: datetime, record: dict[str, Any]) -> None:
    show = night.shows.setdefault(record["show"], ShowNight())
    show.plays += 1
    show.outcomes[record["outcome"]] += 1
    show.played_s += record["played_s"]
    show.missed += record["missed"]
    night.plays_at.append(at)
    if record["error_max_deg"] > show.error_max_deg:
        show.error_max_deg, show.worst = record["error_max_deg"], record["worst"]
    if record["error_max_deg"] > night.error_max_deg:
        night.error_max_deg, night.worst = record["error_max_deg"], record["worst"]
        night.worst_show = record["show"]


def _add_sample(night: Night, at: datetime, record: dict[str, Any]) -> None:
    celsius, volts = record["hottest_c"], record["voltage_min_v"]
    night.samples.append((at, celsius, record["current_a"]))
    if celsius is not None and (night.hottest_c is None or celsius > night.hottest_c):
        night.hottest_c, night.hottest = celsius, record["hottest"]
        night.hottest_at = f"{at:%H:%M}"
    if volts is not None:
        night.voltage_min_v = min(volts, night.voltage_min_v or volts)


def _change_rest(night: Night, at: datetime, reasons: list[str]) -> None:
    present = {_plain(reason) for reason in reasons}
    for reason in set(night._resting) - present:  # noqa: SLF001
        _rested(night, reason, night._resting.pop(reason), at)  # noqa: SLF001
    for reason in present:
        night._resting.setdefault(reason, at)  # noqa: SLF001


def _rested(night: Night, reason: str, from_at: datetime, to_at: datetime) -> None:
    span_s = (to_at - from_at).total_seconds()
    night.rests_s[reason] = night.rests_s.get(reason, 0.0) + span_s


# ---- what to look at


def advice(night: Night) -> list[str]:
    """Return what the owner should look at, the most urgent first."""
    found = []
    if night.given_up:
        found.append("the stage gave up after faults, and waits for a person: look, then wake it")
    for fault, count in Counter(fault.text for fault in night.faults).most_common(5):
        found.append(f"{count} x {fault}")
    if night.hottest_c is not None and night.hottest_c >= HOT_C:
        found.append(
            f"{night.hottest} was {night.hottest_c:.0f} C at {night.hottest_at}: let it rest more "
            f"often (duty), or give it less to carry"
        )
    if night.error_max_deg >= ERROR_DEG:
        found.append(
            f"{night.worst} was {night.error_max_deg:.1f} deg off its plan in {night.worst_show}: "
            f"look for what holds it, or slow the show"
        )
    missed = {name: show.missed for name, show in night.shows.items() if show.missed}
    if missed:
        found.append(f"moves were sent too late in {', '.join(missed)}: see `lss-motion doctor`")
    found += [
        f"cue {name} was always refused: {cue.refused.most_common(1)[0][0]}"
        for name, cue in night.cues.items()
        if not cue.fired and cue.refused
    ]
    if night.lost_lines or night.broken_lines:
        found.append(
            f"{night.lost_lines + night.broken_lines} lines of the log are missing: is the disk "
            f"full?"
        )
    return found


# ---- as text, JSON, HTML


class NightPart(Struct, frozen=True, kw_only=True):
    """A part of what is told of a night: a table with its head, or lines."""

    title: str = ""
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    right: range = range(0)
    """The columns of numbers."""
    lines: tuple[str, ...] = ()


def parts_of(night: Night) -> list[NightPart]:
    """Return what is told of a night."""
    found = advice(night)
    shows = sorted(night.shows.items(), key=lambda item: -item[1].plays)
    cues = sorted(night.cues.items(), key=lambda item: -item[1].fired)
    parts = [
        NightPart(lines=tuple(_summary(night))),
        NightPart(
            title="shows",
            head=("show", "plays", "finished", "left", "minutes", "worst error"),
            right=range(1, 5),
            rows=tuple(
                (
                    name,
                    str(show.plays),
                    str(show.outcomes["finished"]),
                    str(show.outcomes["left"]),
                    f"{show.played_s / 60:.1f}",
                    f"{show.error_max_deg:.1f} deg {show.worst}".rstrip(),
                )
                for name, show in shows
            ),
        ),
        NightPart(
            title="cues",
            head=("cue", "fired", "refused"),
            right=range(1, 2),
            rows=tuple(row for one in cues for row in _cue_rows(*one)),
        ),
    ]
    if night.rests_s:
        rests = tuple(f"{reason} {s / 60:.0f} min" for reason, s in night.rests_s.items())
        parts.append(NightPart(title="rested", lines=rests))
    if night.faults:
        faults = tuple(f"{one.at}  {one.text}" + _after(one) for one in night.faults)
        parts.append(NightPart(title="faults", lines=faults))
    if night.player_faults:
        handled = tuple(f"{count} x {what}" for what, count in night.player_faults.items())
        parts.append(NightPart(title="met by on_fault", lines=handled))
    return [
        *parts,
        NightPart(title="look at" if found else "nothing to look at", lines=tuple(found)),
    ]


def _summary(night: Night) -> Iterator[str]:
    span_s = (night.ends - night.begins).total_seconds()
    plays = sum(show.plays for show in night.shows.values())
    yield (
        f"{night.begins:%Y-%m-%d %H:%M} to {night.ends:%Y-%m-%d %H:%M} ({span_s / 3600:.1f} h): "
        f"{counted(plays, 'play')}, {counted(night.faults, 'fault')}"
        + (", GAVE UP" if night.given_up else "")
    )
    if night.hottest_c is not None:
        yield f"hottest: {night.hottest} {night.hottest_c:.0f} C at {night.hottest_at}"
    if night.worst:
        yield f"worst error: {night.worst} {night.error_max_deg:.1f} deg in {night.worst_show}"
    if night.restarts:
        yield f"began anew: {counted(night.restarts, 'time')}"


def _cue_rows(name: str, cue: CueNight) -> Iterator[tuple[str, str, str]]:
    reasons = ", ".join(f"{count} x {reason}" for reason, count in cue.refused.most_common())
    yield name, str(cue.fired), reasons or "-"
    for why, count in cue.not_played.items():
        yield "", str(count), f"not played: {why}"


def text_of(night: Night) -> list[str]:
    """Return the night for people."""
    lines: list[str] = []
    for part in parts_of(night):
        if part.head:
            lines += ["", *aligned([part.head, *part.rows], right=part.right)]
        elif part.title:
            lines += ["", part.title, *(f"  - {line}" for line in part.lines)]
        else:
            lines += part.lines
    return lines


def _after(fault: FaultNight) -> str:
    return f"; {fault.after}" if fault.after else ""


def as_json(night: Night) -> dict[str, Any]:
    """Return the night for other programs."""
    found = asdict(night)
    for name in ("_resting", "samples", "plays_at"):
        del found[name]
    found |= {"begins": night.begins.isoformat(), "ends": night.ends.isoformat()}
    return {"schema": 1, **found, "look_at": advice(night)}


PAGE: Final = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
       color: #1f2933; background: #fff }}
h2 {{ font-size: 1.1rem; margin: 1.5rem 0 .3rem }} p, ul {{ margin: .2rem 0 }}
div {{ overflow-x: auto }} table {{ border-collapse: collapse }}
th, td {{ text-align: left; padding: .2rem 1.2rem .2rem 0; border-bottom: 1px solid #cbd2d9 }}
.n {{ text-align: right; font-variant-numeric: tabular-nums }}
svg {{ max-width: 100%; height: auto }}
@media (prefers-color-scheme: dark) {{ body {{ color: #e4e7eb; background: #1f2933 }}
  th, td {{ border-color: #52606d }} svg {{ background: #fff; border-radius: 4px }} }}
</style>
<h1>{title}</h1>
{parts}
{plots}
</html>
"""


def html_of(night: Night, name: str) -> str:
    """Return the night as a page that needs no other file; what to look at comes first."""
    summary, *others, look_at = parts_of(night)
    return PAGE.format(
        title=html.escape(f"{name}, {night.begins:%Y-%m-%d}"),
        parts="\n".join(map(_html_part, (summary, look_at, *others))),
        plots=_svg(_figure(night)),
    )


def _html_part(part: NightPart) -> str:
    title = f"<h2>{html.escape(part.title)}</h2>\n" if part.title else ""
    if part.head:
        rows = [_html_row("th", part.head, part.right)]
        rows += [_html_row("td", row, part.right) for row in part.rows]
        return f"{title}<div><table>\n{''.join(rows)}</table></div>"
    lines = [html.escape(line) for line in part.lines]
    if not part.title:
        return "\n".join(f"<p>{line}</p>" for line in lines)
    items = "\n".join(f"<li>{line}</li>" for line in lines)
    return f"{title}<ul>\n{items}\n</ul>" if items else title


def _html_row(tag: str, cells: Sequence[str], right: range) -> str:
    shown = [
        f"<{tag} class=n>{html.escape(cell)}</{tag}>"
        if column in right
        else f"<{tag}>{html.escape(cell)}</{tag}>"
        for column, cell in enumerate(cells)
    ]
    return f"<tr>{''.join(shown)}</tr>\n"


def _figure(night: Night) -> Figure:
    """Draw the temperature, the current and the shows of each hour over the night."""
    from matplotlib.dates import DateFormatter
    from matplotlib.figure import Figure

    from lss_motion.planning.picture import EVENT, KEYFRAME, TEXT

    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    hot, amps, plays = figure.subplots(3, 1, sharex=True)
    for axis, column, title, colour in (
        (hot, 1, "hottest servo, C", "#b03a2e"),
        (amps, 2, "current of all servos, A", EVENT),
    ):
        points = [(one[0], one[column]) for one in night.samples if one[column] is not None]
        if points:
            axis.plot(*zip(*points, strict=True), color=colour, linewidth=1.0)
        axis.set_title(title, fontsize=10, loc="left", color=TEXT)
    hours = max(1, round((night.ends - night.begins).total_seconds() / 3600.0))
    span = night.begins, max(night.ends, night.begins + timedelta(hours=1))
    hot.set_xlim(*span)
    if night.plays_at:
        plays.hist(night.plays_at, bins=min(hours * 4, 200), range=span, color=KEYFRAME)
    plays.set_title("shows in a quarter of an hour", fontsize=10, loc="left", color=TEXT)
    clock = DateFormatter("%H:%M", tz=night.begins.tzinfo)  # type: ignore[no-untyped-call]
    plays.xaxis.set_major_formatter(clock)
    for axis in (hot, amps, plays):
        axis.grid(visible=True, linewidth=0.3)
        axis.tick_params(labelsize=8)
    return figure


def _svg(figure: Figure) -> str:
    data = io.StringIO()
    figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue().partition("<svg")[1] + data.getvalue().partition("<svg")[2]
