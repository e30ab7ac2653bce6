"""sequence.yaml ⇄ Sequence: what the author wants, and when.

`load_sequence(path)` reads a sequence file and the robot file that it names, `write_sequence`
writes one that a person can read and edit, `check_sequence` holds a sequence against a robot,
`sequence_schema()` describes the file to an editor.
"""

from lss_motion.sequence.check import check_sequence
from lss_motion.sequence.load import load_sequence, sequence_schema
from lss_motion.sequence.write import sequence_text, write_sequence

__all__ = [
    "check_sequence",
    "load_sequence",
    "sequence_schema",
    "sequence_text",
    "write_sequence",
]
