"""gait.yaml → `Sequence`: robots with four or six legs that walk, turn and pose.

=============  ===================================================  ===============================
file           what it is                                           called by
=============  ===================================================  ===============================
`model`        the values: `Gait`, `Leg`, `Walk`, `BodyMove`, …     every module here, `walking`
`patterns`     lift times of the legs by pattern; order of legs     `load`, `file`
`file`         the keys of a gait file, their units and bounds      `load`
`load`         file → `Gait`, with its robot; its JSON Schema       `api`, `cli`
`curves`       smooth curves of single quantities                   the modules below, `walking`
`kinematics`   joint angles ⇄ foot of a leg; stability of a stance  `passage`, `pacing`, `steering`
`stepping`     paths of body and feet over the ground               `passage`, `steering`, `walking`
`passage`      body and feet from rest to rest                      `pacing`, `steering`
`pacing`       passages → joint angles within the servo limits      `to_sequence`, `cli`, `walking`
`to_sequence`  joint angles → keyframes                             `api`, `cli`
`steering`     plans of a walk whose velocity changes on the way    `walking.planner`, `cli.walk`
`plot`         picture of a gait                                    `cli.walk`
=============  ===================================================  ===============================

No module reads a clock. Of the servos, only the limits of the robot file are used.
"""

from lss_motion.gait.load import gait_schema, is_gait_file, load_gait
from lss_motion.gait.pacing import paced
from lss_motion.gait.to_sequence import sequence_from, sequence_of

__all__ = [
    "gait_schema",
    "is_gait_file",
    "load_gait",
    "paced",
    "sequence_from",
    "sequence_of",
]
