"""The stage: many shows, and the cues that start them, all evening, unattended.

    stage.yaml ── load ──> Stage ──> Director ── actions ──> player
                                        ^
                 signals, wall clock, what the player did

| file             | what it is                                            | who calls it          |
|------------------|-------------------------------------------------------|-----------------------|
| `file`           | the keys of a stage file                              | `load`, `model`       |
| `model`          | the values: `Stage`, cues, triggers, signals          | all below             |
| `load`           | a file to a `Stage`, with the line of every problem   | `cli`, `studio`, …    |
| `check`          | plans every show, finds what does not go together     | `running`, `cli`      |
| `triggering`     | signals, times of day, timecode → cues they trigger   | `director`            |
| `duty`           | why a figure rests; how often it begins after faults  | `director`            |
| `director`       | decides which show plays                              | `running`, `hosts`    |
| `orders`         | what the director orders and notes                    | `director`, `running` |
| `log`            | what is kept of each night                            | `running`, `hosts`    |
| `running`        | couples director and player, one run after the other  | `job`                 |
| `stage_timecode` | where the timecode is, its show; timecode out         | `running`, `hosts`    |
| `job`            | what the player's process does for a stage            | `hosts`, `studio`     |
| `morning`        | what happened in a night, from the log                | `cli.stages`          |
| `triggers/`      | messages of other programs and devices as triggers    | `studio`, `hosts`     |
| `timecode/`      | timecode in and out                                   | `stage_timecode`      |
| `hosts/`         | one show on many computers                            | `cli`, `studio`       |
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
