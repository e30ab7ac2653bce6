"""The assumptions of FACTS.md, judged by the figures of a field test.

An assumption is `confirmed`, `refuted` or `not seen`. It is judged only by figures that separate it
from what else could be: where a model does not explain its readings, nothing is concluded. One
joint that refutes an assumption is enough.
"""

from __future__ import annotations

import re
from enum import StrEnum
from importlib.resources import files
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from lss_motion.protocol.constants import RESET_S, Status
from lss_motion.robot.model import Response
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.maintenance.field.measure import Figures

TIME_NEAR_S: Final = 0.002
RAMP_NEAR_RATIO: Final = 0.03
"""A value this near to the assumed one confirms it, if its standard error is not larger."""
TIME_FAR_S: Final = 0.004
RAMP_FAR_RATIO: Final = 0.06
FAR_SIGMAS: Final = 5.0
"""A refuted value is off by what matters for playing, and by so many standard errors."""
LOOP_NEAR_RATIO: Final = 0.03
PERIOD_NEAR_RATIO: Final = 0.15
PERIOD_FAR_RATIO: Final = 0.3
"""The phase of the filter and the lag leave a tenth of its period open."""
NOISE_NEAR_DEG: Final = 0.1
NOISE_FAR_DEG: Final = 0.2
"""Root mean square; a scatter of a tenth to either side has 0.06, with the rounding 0.065."""
REPLY_S: Final = (0.00015, 0.0012)
"""Median of the delay of a reply: that of W14 for firmware 369 and later, with room for a host."""
FAST_FIRMWARE: Final = 369
DEAF_S: Final = (0.8 * RESET_S, 1.3 * RESET_S)
TURNED_DEG: Final = 0.2
"""A small move has arrived within two readings' scatter."""
SHOWN_DEG: Final = 0.3
"""Play that leaves less of a move hides it."""
STALLED_RATIO: Final = 0.5

NOT_SEEN: Final = "not seen"


class Ruling(StrEnum):
    """What one measurement says about one assumption."""

    CONFIRMED = "confirmed"
    REFUTED = "refuted"


class Evidence(NamedTuple):
    """One measurement about one assumption: by what, and what it says."""

    fact: str
    outcome: Ruling
    by: str
    text: str


class AssumptionVerdict(Struct, frozen=True):
    """What a field test says about one assumption."""

    fact: str
    title: str
    verdict: str
    """`confirmed`, `refuted by JOINT: …`, or `not seen`."""


def verdicts(steps: Mapping[str, Figures]) -> list[AssumptionVerdict]:
    """Return a verdict for each fact that is assumed, and for each that was judged."""
    told: dict[str, list[Evidence]] = {}
    for one in evidence(steps):
        told.setdefault(one.fact, []).append(one)
    return [
        AssumptionVerdict(fact, title, _verdict(told.get(fact, [])))
        for fact, (title, is_assumed) in facts().items()
        if is_assumed or fact in told
    ]


def _verdict(told: list[Evidence]) -> str:
    against = [one for one in told if one.outcome is Ruling.REFUTED]
    if against:
        return f"refuted by {'; '.join(f'{one.by}: {one.text}' for one in against)}"
    if told:
        return f"confirmed by {'; '.join(f'{one.by}: {one.text}' for one in told)}"
    return NOT_SEEN


_ROW: Final = re.compile(r"^\| (?P<fact>[A-Z]\d+) \|(?P<cells>.*)\|$", re.MULTILINE)
TITLE_MAX: Final = 100


def facts() -> dict[str, tuple[str, bool]]:
    """Return the rows of FACTS.md: a short title, and whether the fact is assumed."""
    text = files("lss_motion").joinpath("FACTS.md").read_text(encoding="utf-8")
    found = {}
    for row in _ROW.finditer(text):
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", row["cells"])]
        title = cells[0] if row["fact"][0] != "A" else f"{cells[0]}: {cells[1]}"
        short = title if len(title) <= TITLE_MAX else f"{title[:TITLE_MAX].rsplit(' ', 1)[0]} …"
        found[row["fact"]] = (short, cells[-2] == "assumed")
    return found


def evidence(steps: Mapping[str, Figures]) -> Iterator[Evidence]:
    """Yield what each step says. The name of a step is what it measures, and of which joint."""
    for name, figures in steps.items():
        what, _, by = name.partition(" ")
        if not figures:
            continue
        match what:
            case "laws":
                yield from _of_laws(by, figures, steps)
            case "small":
                yield from _of_small(by, figures, steps)
            case "filter":
                yield from _of_filter(by, figures, steps)
            case "groups":
                yield from _of_groups(figures)
            case "restart" | "unplug":
                yield from _of_restart(by, figures)


def _of_laws(by: str, found: Figures, steps: Mapping[str, Figures]) -> Iterator[Evidence]:
    usual = Response()
    if found["noise_deg"] <= NOISE_NEAR_DEG:
        yield Evidence("E7", Ruling.CONFIRMED, by, f"{found['noise_deg']:.2f} deg RMS")
    elif found["noise_deg"] > NOISE_FAR_DEG:
        yield Evidence("E7", Ruling.REFUTED, by, f"readings scatter {found['noise_deg']:.2f} deg")
    reply_s = found["turnaround_s"][1]
    if REPLY_S[0] <= reply_s <= REPLY_S[1] and _firmware(by, steps) >= FAST_FIRMWARE:
        yield Evidence("W14", Ruling.CONFIRMED, by, f"{MS_PER_S * reply_s:.2f} ms, median")
    if not found["is_explained"]:
        return
    for facts_of, key, value in (
        (("A10",), "retarget", usual.retarget),
        (("A11", "M14"), "t_law", usual.t_law),
    ):
        decided, is_sure = found[key]
        for fact in facts_of if is_sure else ():
            outcome = Ruling.CONFIRMED if decided == value else Ruling.REFUTED
            yield Evidence(fact, outcome, by, f"it is {decided}")
    lag_s, error_s = found["lag_s"]
    text = f"{MS_PER_S * lag_s:.1f} ± {MS_PER_S * error_s:.1f} ms"
    yield from _near("A13", by, text, abs(lag_s - usual.lag_s), error_s, TIME_NEAR_S, TIME_FAR_S)
    ramps = sorted(found[key] for key in ("accel_deg_s2", "decel_deg_s2"))
    ratio, error = (number / found["ramp_deg_s2"] for number in ramps[0])
    text = f"{ratio:.2f} ± {error:.2f} times AA and AD"
    away = abs(ratio - usual.ramp_ratio)
    yield from _near("A16", by, text, away, error, RAMP_NEAR_RATIO, RAMP_FAR_RATIO)
    if found["loop_s"] is not None:
        loop_s = found["loop_s"][0]
        is_near = abs(loop_s - usual.loop_s) <= LOOP_NEAR_RATIO * usual.loop_s
        outcome = Ruling.CONFIRMED if is_near else Ruling.REFUTED
        yield Evidence("M7", outcome, by, f"every {MS_PER_S * loop_s:.2f} ms")


def _near(
    fact: str, by: str, text: str, away: float, error: float, near: float, far: float
) -> Iterator[Evidence]:
    """Yield what a distance from the assumed value says, if its error is small enough."""
    if away <= near and error <= near:
        yield Evidence(fact, Ruling.CONFIRMED, by, text)
    elif away > max(far, FAR_SIGMAS * error):
        yield Evidence(fact, Ruling.REFUTED, by, text)


def _firmware(by: str, steps: Mapping[str, Figures]) -> int:
    known = steps.get("scan", {}).get("firmware", {})
    return known.get(by.split(" ", maxsplit=1)[0]) or 0


def _of_small(by: str, found: Figures, steps: Mapping[str, Figures]) -> Iterator[Evidence]:
    """Compare small moves with what the play of the gears, known from the laws, leaves of them."""
    laws = steps.get(f"laws {by}")
    if not laws or not laws["is_explained"]:
        return
    play_deg, error_deg = laws["play_deg"]
    told = []
    for move in found["moves"]:
        shown_deg = move["size_deg"] - play_deg
        if shown_deg < SHOWN_DEG + error_deg:
            continue
        turned_deg = fmean(move["turned_deg"])
        text = f"{move['size_deg']:g} deg turns it by {turned_deg:.2f} deg"
        if turned_deg < STALLED_RATIO * shown_deg:
            yield Evidence("M32", Ruling.REFUTED, by, f"{text}, status {found['status']}")
            return
        if abs(turned_deg - shown_deg) > TURNED_DEG + 0.1 * shown_deg:
            return
        told.append(text)
    if told:
        yield Evidence("M32", Ruling.CONFIRMED, by, told[-1])


def _of_filter(by: str, found: Figures, steps: Mapping[str, Figures]) -> Iterator[Evidence]:
    laws = steps.get(f"laws {by}")
    if not laws or not laws["is_explained"]:
        return
    lates_s = [late_s - laws["delay_s"][0] for late_s in found["late_s"]]
    period_s = fmean(lates_s) / (found["filter_count"] - 0.5)
    spread = stdev(lates_s) / (len(lates_s) ** 0.5 * (found["filter_count"] - 0.5))
    usual_s = Response().filter_s
    text = f"{MS_PER_S * period_s:.1f} ms a step at FPC {found['filter_count']}"
    away, error = abs(period_s - usual_s) / usual_s, (spread + laws["delay_s"][1]) / usual_s
    yield from _near("M6", by, text, away, error, PERIOD_NEAR_RATIO, PERIOD_FAR_RATIO)


def _of_groups(found: Figures) -> Iterator[Evidence]:
    for bus, group in found.items():
        asked, answered = group["asked"], group["answered"]
        right = sum(ids == asked for ids in answered)
        disordered = [ids for ids in answered if sorted(ids) == sorted(asked) and ids != asked]
        if right > len(answered) // 2:
            yield Evidence("W17", Ruling.CONFIRMED, bus, f"{len(asked)} servos answer in order")
        elif disordered:
            yield Evidence("W17", Ruling.REFUTED, bus, f"they answer as {disordered[0]}")
        elif not any(answered):
            yield Evidence("W17", Ruling.REFUTED, bus, "no servo answers a group")


def _of_restart(by: str, found: Figures) -> Iterator[Evidence]:
    if (deaf_s := found.get("deaf_s")) is not None:
        is_near = DEAF_S[0] <= deaf_s <= DEAF_S[1]
        outcome = Ruling.CONFIRMED if is_near else Ruling.REFUTED
        yield Evidence("R4", outcome, by, f"{deaf_s:.2f} s until it answers")
    status = found.get("status")
    if status and not found["has_first"]:
        is_limp = status == Status.LIMP.name
        outcome = Ruling.CONFIRMED if is_limp else Ruling.REFUTED
        yield Evidence("R3", outcome, by, f"it is {Status[status].value}")
