"""The stage: many shows, and the cues that start them, all evening, unattended.

    stage.yaml ── load ──> Stage ──> Director ── actions ──> player
                                        ^
                 signals, wall clock, what the player did

==============  =================================================================================
file            the keys of a stage file
model           the values of a stage; what a trigger and a signal are
load            a file to a `Stage`, with the line of every problem
time_of_day     cron expressions and quiet hours on a clock that may be set
check           plans every show of a stage, and finds what does not go together
triggers        from signals to the cues that they trigger
duty            why a figure rests, and how often it begins again after faults
director        decides which show plays
orders          what the director orders and notes
records         what has been done and refused, for the log and for operators
running         couples the director and the player, one run after the other
playing         what these runs keep: which shows play, two taps as one
timecode        where the timecode is, and the show that follows it
sending         timecode out, from the clock of the shows that play
job             what the process of the player does for a stage, and its client
log             what is kept of each night
morning         what happened in a night, from the log
==============  =================================================================================
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.files.source import read_text

if TYPE_CHECKING:
    from pathlib import Path

_STAGE_KEY: Final = re.compile(r"^stage\s*:", re.MULTILINE)
"""A top-level key that no other file has."""


def is_stage_file(path: Path) -> bool:
    """Return whether a file describes a stage; raise `InputError` if it cannot be read.

    It stands here since `check` asks it of every file: the modules of stages are then imported for
    stages only.
    """
    return path.suffix.lower() in (".yaml", ".yml") and bool(_STAGE_KEY.search(read_text(path)))
