"""MCAP files of ROS 2 and of `lss-motion export`: joint states, one motion for each topic.

Messages are `sensor_msgs/msg/JointState` in CDR, with any of the joints in each. Positions are
radians (REP 103), or metres for a sliding joint. The time is the stamp of the message; where no
stamp is set it is when the message was recorded. Needs the library mcap: the extra `[mcap]`.
"""

from __future__ import annotations

import io
import math
import struct
from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError, install_command
from lss_motion.files.source import RECORDING_MAX_BYTES
from lss_motion.interchange.fields import NUMBER_MAX
from lss_motion.interchange.reader import (
    DIGITS,
    VALUES_MAX,
    Reader,
    motion_of_curves,
    unit_of_ros_joint,
)
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

MAGIC: Final = b"\x89MCAP0\r\n"
JOINT_STATES: Final = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
BROKEN: Final = (struct.error, ValueError, EOFError, MemoryError, RuntimeError, OverflowError)
"""What the libraries raise for a file that is damaged, besides errors of their own."""
NAMES_MAX: Final = 1000
"""Chosen: joints of one message."""


def _is_mcap(data: bytes) -> bool:
    return data.startswith(MAGIC)


def _mcap_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    topics: defaultdict[str, list[tuple[float, float, dict[str, float]]]] = defaultdict(list)
    count = 0
    for topic, logged_s, content in _messages(path, data):
        stamp_s, positions = _joint_state(path, content)
        count += len(positions)
        if count > VALUES_MAX:
            raise InputError(f"has more than {VALUES_MAX:,} values, the maximum", path=path)
        topics[topic].append((stamp_s, logged_s, positions))
    if not any(positions for rows in topics.values() for _, _, positions in rows):
        raise InputError(
            f"has no positions of joints: no message is a {JOINT_STATES[0]} in CDR", path=path
        )
    return tuple(
        _motion(path, topic, rows)
        for topic, rows in topics.items()
        if any(positions for _, _, positions in rows)
    )


MCAP: Final = Reader("mcap", _is_mcap, _mcap_motions)
"""Reads joint states, by topic."""


def _motion(
    path: Path, topic: str, rows: list[tuple[float, float, dict[str, float]]]
) -> ForeignMotion:
    has_stamps = any(stamp_s for stamp_s, _, _ in rows)
    samples: defaultdict[str, dict[float, tuple[float, int]]] = defaultdict(dict)
    for stamp_s, logged_s, positions in rows:
        at_s = round(stamp_s if has_stamps else logged_s, DIGITS)
        for joint, position in positions.items():
            samples[joint].setdefault(at_s, (position, 0))
    about = [f"Imported from {path.name} (MCAP, topic {topic:.60})."]
    if "command" in topic:
        about.append("These are targets, at the instants at which they were sent.")
    return motion_of_curves(path, topic.strip("/"), samples, unit_of_ros_joint, comments=about)


def _messages(path: Path, data: bytes) -> Iterator[tuple[str, float, bytes]]:
    """Yield topic, time of recording and content of each joint state."""
    try:
        from mcap import records
    except ImportError as error:
        raise InputError(f"MCAP needs a library: {install_command('mcap')}", path=path) from error
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    for one in _records(path, data):
        if isinstance(one, records.Schema):
            schemas[one.id] = one.name
        elif isinstance(one, records.Channel):
            if schemas.get(one.schema_id) in JOINT_STATES and one.message_encoding == "cdr":
                topics[one.id] = one.topic
        elif isinstance(one, records.Message) and one.channel_id in topics:
            yield topics[one.channel_id], one.log_time / NS_PER_S, one.data


def _records(path: Path, data: bytes) -> Iterator[Any]:
    """Yield the records of a file, those of its chunks in their place."""
    import lz4.frame
    import zstandard
    from mcap import records
    from mcap.exceptions import McapError
    from mcap.stream_reader import StreamReader, breakup_chunk

    def unpacked(chunk: Any) -> Any:  # noqa: ANN401  (a library without types)
        """Return a chunk without compression, with no more bytes than it says."""
        size, packed = chunk.uncompressed_size, io.BytesIO(chunk.data)
        if chunk.compression == "zstd":
            chunk.data = zstandard.ZstdDecompressor().stream_reader(packed).read(size)
        elif chunk.compression == "lz4":
            chunk.data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
        elif chunk.compression:
            raise ValueError(f"compression {chunk.compression!r:.20} is not known")
        chunk.compression = ""
        return chunk

    left_bytes = RECORDING_MAX_BYTES
    try:
        stream = StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=len(data))
        for record in stream.records:
            if not isinstance(record, records.Chunk):
                yield record
                continue
            left_bytes -= record.uncompressed_size
            if left_bytes < 0:
                raise ValueError(f"it holds more than {RECORDING_MAX_BYTES:,} bytes")
            yield from breakup_chunk(unpacked(record))
    except (McapError, zstandard.ZstdError, *BROKEN) as error:
        reason = str(error).splitlines()[0] if str(error) else "it was cut off"
        raise InputError(f"cannot be read as MCAP: {reason:.200}", path=path) from error


def _joint_state(path: Path, content: bytes) -> tuple[float, dict[str, float]]:
    """Return the stamp of a message and the positions by joint, or raise `InputError`."""
    try:
        cdr = _Cdr(content)
        stamp_s = cdr.stamp_s()
        cdr.text()
        names, positions = cdr.texts(), cdr.positions()
    except (struct.error, UnicodeError, ValueError) as error:
        raise InputError(f"a joint state cannot be read: {error}", path=path) from error
    if positions and (len(positions) != len(names) or len(set(names)) < len(names)):
        reason = f"a joint state has {len(positions)} positions for {len(names)} joints"
        raise InputError(reason, path=path)
    if not all(abs(position) <= NUMBER_MAX for position in positions):
        raise InputError("a joint state has a position that is out of range", path=path)
    return stamp_s, dict(zip(names, positions, strict=False))


class _Cdr:
    """The values of a message in CDR, one after the other, each at a multiple of its size."""

    def __init__(self, content: bytes) -> None:
        if content[:2] not in (b"\x00\x00", b"\x00\x01"):
            raise ValueError("its encoding is not plain CDR")
        self._order = "<" if content[1] else ">"
        self._body = content[4:]
        self._at = 0

    def stamp_s(self) -> float:
        """Return a time of seconds and nanoseconds."""
        (seconds,), (rest_ns,) = self._values("i", 1), self._values("I", 1)
        return float(seconds + rest_ns / NS_PER_S)

    def texts(self) -> list[str]:
        """Return a list of texts."""
        return [self.text() for _ in range(self._count(NAMES_MAX))]

    def positions(self) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        found = self._values("d", self._count(NAMES_MAX))
        for value in found:
            if not math.isfinite(value):
                raise ValueError(f"{value} is no position")
        return found

    def text(self) -> str:
        """Return one text."""
        size = self._count(len(self._body))
        data = self._body[self._at : self._at + size]
        if len(data) < size:
            raise ValueError("it was cut off")
        self._at += size
        return data.rstrip(b"\0").decode()

    def _count(self, maximum: int) -> int:
        (count,) = self._values("I", 1)
        if count > maximum:
            raise ValueError(f"{count} values are more than {maximum}")
        return int(count)

    def _values(self, kind: str, count: int) -> tuple[Any, ...]:
        if not count:
            return ()
        self._at += -self._at % struct.calcsize(kind)
        form = f"{self._order}{count}{kind}"
        values = struct.unpack_from(form, self._body, self._at)
        self._at += struct.calcsize(form)
        return values
