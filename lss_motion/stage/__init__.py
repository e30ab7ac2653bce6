"""The stage: many shows, and the cues that start them, all evening, unattended.

    stage.yaml ── load ──> Stage ──> Director ── actions ──> player
                                        ^
                 signals, wall clock, what the player did

===============  ===============================================================================
file             the keys of a stage file
model            the values of a stage; what a trigger and a signal are
load             a file to a `Stage`, with the line of every problem
check            plans every show of a stage, and finds what does not go together
triggering       from signals, times of day and timecode to the cues that they trigger
duty             why a figure rests, and how often it begins again after faults
director         decides which show plays
orders           what the director orders and notes
log              what is kept of each night
running          couples the director and the player, one run after the other
stage_timecode   where the timecode is, the show that follows it; timecode out
job              what the process of the player does for a stage, and its client
morning          what happened in a night, from the log
triggers/        messages of other programs and devices as triggers
timecode/        timecode in and out
hosts/           one show on many computers
===============  ===============================================================================
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
