"""What must hold for any bytes given to a reader: the hook of every fuzzer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.interchange.reader import RefusedMotion

if TYPE_CHECKING:
    from lss_motion.interchange.reader import ForeignMotion, Reader

_PATH = Path("fuzz.bin")


def fuzz_one(reader: Reader, data: bytes) -> bool:
    """Read `data` and return whether a motion came of it.

    Raises whatever a reader raises beside `InputError`, and `AssertionError` for a motion without
    channels or a refusal without words.
    """
    reader.recognises(data)
    motions: tuple[ForeignMotion | RefusedMotion, ...]
    try:
        motions = reader.motions(_PATH, data)
    except InputError as error:
        motions = (RefusedMotion(name="the file", error=error),)
    assert motions, "neither a motion nor a refusal"
    for motion in motions:
        if isinstance(motion, RefusedMotion):
            assert motion.error.reason, "a refusal without words"
        else:
            # What a channel must be, it has asserted itself when it was made.
            assert motion.channels, "a motion without a joint"
            assert len({channel.name for channel in motion.channels}) == len(motion.channels)
    return any(not isinstance(motion, RefusedMotion) for motion in motions)
