"""The formats that can be read, and which motion of a file is meant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.interchange.bitbots import BitBotsReader
from lss_motion.interchange.blender import BlenderReader
from lss_motion.interchange.bottango import BottangoReader
from lss_motion.interchange.commands import CommandReader
from lss_motion.interchange.csv_table import CsvReader
from lss_motion.interchange.hulks import HulksReader
from lss_motion.interchange.maestro import MaestroReader
from lss_motion.interchange.pypose import PyPoseReader
from lss_motion.interchange.pypot import PypotReader
from lss_motion.interchange.reader import DIGITS, ForeignMotion, RefusedMotion
from lss_motion.interchange.robotis_pages import RobotisPagesReader
from lss_motion.interchange.robotis_text import RobotisTextReader
from lss_motion.interchange.ros import RosReader
from lss_motion.interchange.ssc32_table import Ssc32TableReader
from lss_motion.interchange.webots import WebotsReader
from lss_motion.sequence.timing import TIME_MAX_S
from lss_motion.source_file import read_data
from lss_motion.spelling import known_names

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Sequence as SequenceOf

    from lss_motion.interchange.reader import Reader

READERS: Final[tuple[Reader, ...]] = (
    BitBotsReader(),
    HulksReader(),
    PypotReader(),
    BlenderReader(),
    BottangoReader(),
    WebotsReader(),
    RobotisTextReader(),
    MaestroReader(),
    Ssc32TableReader(),
    PyPoseReader(),
    RosReader(),
    CsvReader(),
    CommandReader(),
    RobotisPagesReader(),
)
"""In the order in which they are asked whether they know a content; special before general."""

FORMAT_NAMES: Final = tuple(reader.name for reader in READERS)
"""What `format_name` may be."""

FILE_MAX_BYTES: Final = 64_000_000
"""Ten minutes of 20 joints at 100 Hz are 42 MB in the wordiest format (pypot). Measured: 50 MB of
CSV take 0.2 to 0.6 GB of memory, 50 MB of JSON 0.6 GB, 1 GB at the very worst."""


def read_motion(
    path: Path | str, *, format_name: str | None = None, motion_name: str | None = None
) -> ForeignMotion:
    """Return what another tool's file says, before any robot is asked.

    A file that holds several motions needs `motion_name`.
    """
    motions = read_motions(path, format_name=format_name)
    names = [motion.name for motion in motions]
    if motion_name is None and len(motions) == 1:
        chosen = motions[0]
    elif motion_name is None:
        listed = "\n".join(f"  {name}" for name in names)
        raise InputError(
            f"holds {len(motions)} motions; name one with --motion:\n{listed}", path=path
        )
    elif motion_name in names:
        chosen = motions[names.index(motion_name)]
    else:
        known = known_names(motion_name, names)
        raise InputError(f"has no motion {motion_name!r}; {known}", path=path)
    if isinstance(chosen, RefusedMotion):
        raise chosen.error
    return chosen


def read_motions(
    path: Path | str, *, format_name: str | None = None
) -> tuple[ForeignMotion | RefusedMotion, ...]:
    """Return all motions of another tool's file, each under a name of its own."""
    path = Path(path)
    if format_name is not None and format_name not in FORMAT_NAMES:
        known = known_names(format_name, FORMAT_NAMES)
        raise InputError(f"unknown motion format {format_name!r}; {known}")
    data = read_data(path, FILE_MAX_BYTES)
    for reader in READERS:
        if reader.name == format_name or (format_name is None and reader.recognises(data)):
            return tuple(_distinct(reader.motions(path, data)))
    raise InputError(
        f"is in no motion format that can be read; there are: {', '.join(FORMAT_NAMES)}; "
        "name one with --from to see what is wrong",
        path=path,
    )


def _distinct(
    motions: SequenceOf[ForeignMotion | RefusedMotion],
) -> Iterator[ForeignMotion | RefusedMotion]:
    """Yield the motions, a number after names that came before, and the times of a show."""
    taken: set[str] = set()
    for motion in motions:
        name, number = motion.name, 2
        while name in taken:
            name, number = f"{motion.name} ({number})", number + 1
        taken.add(name)
        named = replace(motion, name=name)
        yield _from_zero(named) if isinstance(named, ForeignMotion) else named


def _from_zero(motion: ForeignMotion) -> ForeignMotion:
    """Return the motion with times of a show: dates and times before 0 are moved to begin at 0."""
    start_s = min(float(channel.times_s[0]) for channel in motion.channels)
    if 0.0 <= start_s <= TIME_MAX_S:
        return motion
    return replace(
        motion,
        channels=tuple(
            replace(channel, times_s=np.round(channel.times_s - start_s, DIGITS))
            for channel in motion.channels
        ),
        notes={round(at_s - start_s, DIGITS): note for at_s, note in motion.notes.items()},
        comments=(*motion.comments, f"Times start at {start_s:f} s in the file and at 0 here."),
    )
