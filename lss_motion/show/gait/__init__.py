"""gait.yaml → `Sequence`: robots with four or six legs that walk, turn and pose.

=============  ===================================================  ===============================
file           what it is                                           called by
=============  ===================================================  ===============================
`model`        the values: `Gait`, `Leg`, `Walk`, …; the patterns   every module here, `walking`
`file`         the keys of a gait file, their units and bounds      `load`
`load`         file → `Gait` → `Sequence`; its JSON Schema          `api`, `cli`
`curves`       smooth curves of single quantities                   the modules below, `walking`
`kinematics`   joint angles ⇄ foot of a leg; stability of a stance  `passage`, `pacing`, `steering`
`stepping`     paths of body and feet over the ground               `passage`, `steering`, `walking`
`passage`      body and feet from rest to rest                      `pacing`, `steering`
`pacing`       passages → joint angles within the servo limits      `load`, `cli`, `walking`
`steering`     plans of a walk whose velocity changes on the way    `walking.planner`, `cli.walk`
=============  ===================================================  ===============================

No module reads a clock. Of the servos, only the limits of the robot file are used.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.files.source import read_text

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence

_GAIT_KEY: Final = re.compile(r"""^(gait|"gait"|'gait')\s*:""", re.MULTILINE)


def is_gait_file(path: Path | str) -> bool:
    """Return whether a file has the key `gait` at its top; raises `InputError` if unreadable.

    It stands here since every show is asked: the modules of gaits are then imported for gaits only.
    """
    return _GAIT_KEY.search(read_text(Path(path))) is not None


def gait_as_sequence(path: Path, robot: Robot) -> Sequence | None:
    """Return the keyframes of the gait file at `path`; None if it is not a gait file.

    Raises what `load_gait` and `paced` raise.
    """
    if not is_gait_file(path):
        return None
    from lss_motion.show.gait.load import load_gait, sequence_of

    return sequence_of(load_gait(path, robot), robot)
