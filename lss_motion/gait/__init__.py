"""gait.yaml → Sequence: robots with four or six legs, walking.

`load_gait(path)` reads a gait file, `paced` makes it joint angles within the limits of a robot,
`sequence_of` makes those the keyframes that everything else plays. No time passes here and no
servo is known beyond its limits.
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
