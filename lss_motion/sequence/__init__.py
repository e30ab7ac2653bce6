"""sequence.yaml ⇄ Sequence: what the author wants, and when.

`load.load_sequence(path)` reads a sequence file and the robot file that it names,
`write.write_sequence` writes one that a person can read and edit, `check.check_sequence` holds a
sequence against a robot, `load.sequence_schema()` describes the file to an editor.
"""
