"""The `events` of a sequence file: colours, words, functions and sounds at times of the show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.protocol.constants import Led
from lss_motion.sequence.functions import function_problem
from lss_motion.sequence.model import Cue
from lss_motion.spelling import known_names

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.file import EventEntry
    from lss_motion.yaml_source import Location, YamlSource

KINDS = ("led", "say", "run", "sound")


def cues(
    entries: Sequence[EventEntry],
    left_out: frozenset[Location],
    source: YamlSource,
    robot: Robot | None,
    note: Callable[[Location, str], None],
) -> Iterator[Cue]:
    """Yield what the entries mean; `note` is told what is wrong and where."""
    folder = source.path.absolute().parent
    for index, entry in enumerate(entries):
        place: Location = ("events", index)
        if place in left_out:
            continue
        given = [kind for kind in KINDS if getattr(entry, kind) is not None]
        if len(given) != 1:
            note(
                place, f"an event is one of {', '.join(KINDS)}, not {' and '.join(given) or 'none'}"
            )
            continue
        if entry.lead_s and entry.sound is None:
            note((*place, "lead_s"), "lead_s belongs to a sound")
        if entry.sound is not None and not (folder / entry.sound).is_file():
            looked = folder / entry.sound
            note((*place, "sound"), f"sound file {entry.sound!r} not found; looked for {looked}")
        if entry.run is not None and (problem := function_problem(entry.run, str(folder))):
            note((*place, "run"), f"run: {entry.run!r} cannot be used: {problem}")
        known = {} if robot is None else robot.joints
        for name in entry.led or () if robot is not None else ():
            if name not in known:
                note((*place, "led", name), f"unknown joint {name!r}; {known_names(name, known)}")
        led = {} if entry.led is None else entry.led
        yield Cue(
            at_s=entry.at_s,
            led=tuple((name, int(Led[colour.upper()])) for name, colour in led.items()),
            say=entry.say or "",
            run=entry.run or "",
            sound="" if entry.sound is None else str(folder / entry.sound),
            lead_s=entry.lead_s,
            folder=str(folder) if entry.run else "",
            line=source.line(place),
        )
