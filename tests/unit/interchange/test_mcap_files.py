"""MCAP: what `export` writes of a log is imported again, and files of others, and errors."""

from __future__ import annotations

import io
import math
import struct

import pytest

from lss_motion.cli.main import main
from lss_motion.interchange.importing import read_motions
from lss_motion.interchange.mcap_files import MCAP, _records
from lss_motion.interchange.reader import ForeignMotion, Measure
from tests.unit.interchange.conftest import PATH

pytest.importorskip("mcap")

SHOW = """\
sequence: wave
robot: arm.yaml
keyframes:
- {at_s: 0, deg: {base: 0, elbow: 0}}
- {at_s: 1, deg: {base: 40}}
- {at_s: 2, deg: {base: -10, elbow: 30}}
"""


def cdr(positions: dict[str, float], stamp_ns: int = 0, order: str = "<") -> bytes:
    body = bytearray(struct.pack(order + "iI", *divmod(stamp_ns, 10**9)))

    def add(form: str, *values: float) -> None:
        body.extend(bytes(-len(body) % struct.calcsize(form[-1:])))
        body.extend(struct.pack(order + form, *values))

    def text(word: str) -> None:
        add("I", len(word) + 1)
        body.extend(word.encode() + b"\0")

    text("")
    add("I", len(positions))
    for name in positions:
        text(name)
    add("I", len(positions))
    for value in positions.values():
        add("d", value)
    add("II", 0, 0)
    return (b"\0\1\0\0" if order == "<" else bytes(4)) + bytes(body)


def mcap_file(
    messages: list[tuple[int, bytes]],
    *,
    compression: str = "NONE",
    schema: str = "sensor_msgs/msg/JointState",
    encoding: str = "cdr",
) -> bytes:
    from mcap.writer import CompressionType, Writer

    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType[compression])
    writer.start(profile="ros2", library="test")
    schema_id = writer.register_schema(schema, "ros2msg", b"")
    channel = writer.register_channel("/joint_states", encoding, schema_id)
    for at_ns, data in messages:
        writer.add_message(channel, log_time=at_ns, publish_time=at_ns, data=data)
    writer.finish()
    return out.getvalue()


FIVE = [(n * 10**8, cdr({"a": n / 10, "lift": 1.0}, n * 10**8)) for n in range(5)]


def test_what_we_export_of_a_log_is_imported_again(tmp_path, arm) -> None:
    (tmp_path / "wave.yaml").write_text(SHOW)
    log, out = tmp_path / "wave.log", tmp_path / "wave.mcap"
    assert (
        main(["play", str(tmp_path / "wave.yaml"), "--virtual", "--quiet", "--log", str(log)]) == 0
    )
    assert main(["export", str(log), "-o", str(out)]) == 0
    commands, states = sorted(read_motions(out), key=lambda motion: motion.name)
    assert (commands.name, states.name) == ("joint_commands", "joint_states")
    assert isinstance(states, ForeignMotion)
    base = next(channel for channel in states.channels if channel.name == "base")
    assert base.unit is Measure.RAD
    reached_deg = [math.degrees(value) for value in base.values]
    assert max(reached_deg) == pytest.approx(40.0, abs=2.0)
    assert reached_deg[-1] == pytest.approx(-10.0, abs=2.0)
    assert len(base.times_s) > 5
    sequence = tmp_path / "again.yaml"
    robot = ["--robot", str(tmp_path / "arm.yaml")]
    asked = ["import", str(out), *robot, "--motion", "joint_states", "-o", str(sequence)]
    assert main(asked) == 0
    assert main(["check", str(sequence)]) == 0


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_joint_states_of_others_in_each_encoding(read_one, compression: str, order: str) -> None:
    messages = [(7 * 10**9, cdr({"a": n / 10, "lift": 1.0}, n * 10**8, order)) for n in range(20)]
    a, lift = read_one(MCAP, mcap_file(messages, compression=compression)).channels
    assert (a.name, a.unit, lift.unit) == ("a", Measure.RAD, Measure.RAD_OR_M)
    assert a.times_s.tolist() == pytest.approx([n / 10 for n in range(20)])
    assert a.values.tolist() == pytest.approx([n / 10 for n in range(20)])


def test_without_stamps_the_time_of_recording_counts(read_one) -> None:
    messages = [(n * 10**8, cdr({"a": n / 10})) for n in range(5)]
    (a,) = read_one(MCAP, mcap_file(messages)).channels
    assert a.times_s.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (mcap_file([]), "has no positions of joints"),
        (mcap_file(FIVE, schema="sensor_msgs/msg/Image"), "has no positions of joints"),
        (mcap_file(FIVE, encoding="json"), "has no positions of joints"),
        (mcap_file([(0, cdr({"a": math.nan}))]), "nan is no position"),
        (mcap_file([(0, cdr({"a": 1e300}))]), "out of range"),
        (mcap_file([(0, cdr({"a": 1.0})[:20])]), "a joint state cannot be read"),
        (mcap_file([(0, b"\0\3\0\0")]), "its encoding is not plain CDR"),
        (mcap_file(FIVE)[:-200], "cannot be read as MCAP"),
        (mcap_file(FIVE)[:60], "cannot be read as MCAP"),
        (mcap_file([(0, bytes(70_000_000))], compression="ZSTD"), "it holds more than 64,000,000"),
    ],
)
def test_what_is_no_motion_or_damaged_is_refused(refusal, data: bytes, reason: str) -> None:
    assert MCAP.recognises(data)
    assert reason in refusal(MCAP, data).reason


@pytest.mark.parametrize("compression", ["LZ4", "ZSTD"])
def test_a_chunk_is_not_unpacked_beyond_the_size_that_it_gives(compression: str) -> None:
    data = mcap_file([(0, bytes(40_000_000))], compression=compression)
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    stream = StreamReader(io.BytesIO(data), emit_chunks=True)
    size = next(one.uncompressed_size for one in stream.records if isinstance(one, Chunk))
    at = data.index(struct.pack("<Q", size))
    lying = data[:at] + struct.pack("<Q", 100) + data[at + 8 :]
    with pytest.raises(Exception, match="cannot be read as MCAP"):
        list(_records(PATH, lying))
