"""One cue as a line of a program's text: its instant and a JSON object of what happens.

# cue: 1500000 {"led": {"elbow": 1}}
# cue: 2000000 {"sound": "/home/me/show/bell.wav", "lead_s": 0.1}
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from lss_motion.protocol.constants import Led
from lss_motion.sequence.model import Cue
from lss_motion.units import s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Collection


def cue_line(cue: Cue) -> str:
    """Return the text after `# cue: `."""
    said = {
        "led": dict(cue.led),
        "say": cue.say,
        "run": cue.run,
        "folder": cue.folder,
        "sound": cue.sound,
        "lead_s": cue.lead_s,
    }
    kept = {key: value for key, value in said.items() if value}
    return f"{us_from_s(cue.at_s)} {json.dumps(kept)}"


def read_cue(text: str, joints: Collection[str]) -> Cue:
    """Return what `cue_line` wrote; raise ValueError with a reason for anything else."""
    at_us, _, body = text.partition(" ")
    try:
        said = json.loads(body)
        at_s = s_from_us(int(at_us))
    except ValueError as error:
        raise ValueError("a cue is a whole number of us and a JSON object") from error
    if not isinstance(said, dict):
        raise ValueError("a cue is a whole number of us and a JSON object")  # noqa: TRY004
    led, lead_s = said.pop("led", {}), said.pop("lead_s", 0.0)
    if not isinstance(led, dict) or not all(code in set(Led) for code in led.values()):
        raise ValueError(f"led is joints with colours from {min(Led)} to {max(Led)}")
    if unknown := sorted(led.keys() - set(joints)):
        raise ValueError(f"the robot has no joint {unknown[0]!r}")
    if not isinstance(lead_s, int | float) or not 0.0 <= lead_s < 1e6:
        raise ValueError("lead_s is a time in seconds from 0 on")
    if not said.keys() <= {"say", "run", "folder", "sound"} or not all(
        isinstance(value, str) for value in said.values()
    ):
        raise ValueError("a cue has led, say, run with folder, or sound with lead_s")
    return Cue(at_s=at_s, led=tuple(led.items()), lead_s=float(lead_s), **said)
