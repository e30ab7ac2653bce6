"""A log of a run as MCAP, for Foxglove, PlotJuggler, rosbag2 and other programs.

    /joint_states    sensor_msgs/msg/JointState: a position that a servo reported, one joint each
    /joint_commands  sensor_msgs/msg/JointState: the target of a `D` that was sent, one joint each.
                     Servos behind mechanisms are `servo:NAME` in both, in degrees of ideal servos
    /events          JSON: `type` and the fields of each event; requests of a person

Angles are joint angles in radians. Times are those of the log: nanoseconds since the run began.
Needs the library mcap: the extra `[mcap]`.
"""

from __future__ import annotations

import io
import math
import struct
from typing import TYPE_CHECKING, Final

import msgspec

from lss_motion.errors import InputError, install_command
from lss_motion.planning.trajectory.servo_motion import servo_name
from lss_motion.playing.hands_mapping import JointReading, JointReadings
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.log import HappenedLine, PortLine, ReceivedLine, RequestedLine
from lss_motion.playing.replay import sent_lines
from lss_motion.protocol.framing import Command, CommandParser, Reply, ReplyParser
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.playing.log import LogLine
    from lss_motion.robot.model import Joint, Robot

STATES: Final = "/joint_states"
COMMANDS: Final = "/joint_commands"
EVENTS: Final = "/events"

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
JOINT_STATE_TEXT: Final = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
"""The definition of the message, as the encoding `ros2msg` of MCAP requires it."""

EVENT_SCHEMA: Final = {
    "type": "object",
    "properties": {"type": {"type": "string"}},
    "required": ["type"],
}

CDR_HEAD: Final = b"\x00\x01\x00\x00"
"""Little endian, no options."""


def mcap_of_log(lines: Sequence[LogLine], robot: Robot) -> bytes:
    """Return the content of an MCAP file; raise `InputError` if the library is missing."""
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError as error:
        raise InputError(f"MCAP needs a library: {install_command('mcap')}") from error
    out = io.BytesIO()
    # Without compression, no further library is needed to read the file.
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile="ros2", library="lss_motion")
    state = writer.register_schema(JOINT_STATE, "ros2msg", JOINT_STATE_TEXT.encode())
    described = msgspec.json.encode(EVENT_SCHEMA)
    event = writer.register_schema("lss_motion/Event", "jsonschema", described)
    channels = {topic: writer.register_channel(topic, "cdr", state) for topic in (STATES, COMMANDS)}
    channels[EVENTS] = writer.register_channel(EVENTS, "json", event)
    messages = [*_angles(lines, robot), *_events(lines)]
    messages.sort(key=lambda message: message[0])
    for at_ns, topic, data in messages:
        writer.add_message(channels[topic], log_time=at_ns, publish_time=at_ns, data=data)
    writer.finish()  # type: ignore[no-untyped-call,unused-ignore]
    return out.getvalue()


Message = tuple[int, str, bytes]


def _angles(lines: Sequence[LogLine], robot: Robot) -> Iterator[Message]:
    """Yield a message for every position that was reported, and for every target that was sent.

    The angles of joints behind mechanisms follow from those of their servos.
    """
    view = JointView(robot)
    servos = {(one.bus, one.servo_id): one for one in robot.servo_robot.joints.values()}
    mixed = JointReadings(view)
    for at_ns, servo, wire in _reported(lines, servos):
        deg = _servo_deg(servo, wire)
        if view.mechanism_of_servo(servo.name) is not None:
            yield at_ns, STATES, _joint_state(at_ns, servo_name(servo.name), deg)
        for one in mixed.add(JointReading(servo.name, at_ns, deg)):
            yield at_ns, STATES, _joint_state(one.at_ns, one.joint, one.deg)
    commands = CommandParser(grouped=False)
    for at_ns, bus, line in sent_lines(lines):
        for sent in commands.feed(line):
            if isinstance(sent, Command) and sent.keyword == "D" and isinstance(sent.value, int):
                target = servos.get((bus, sent.servo_id))
                if target is not None:
                    is_joint = view.mechanism_of_servo(target.name) is None
                    name = target.name if is_joint else servo_name(target.name)
                    state = _joint_state(at_ns, name, _servo_deg(target, sent.value))
                    yield at_ns, COMMANDS, state


def _reported(
    lines: Sequence[LogLine], servos: Mapping[tuple[str, int], Joint]
) -> Iterator[tuple[int, Joint, int]]:
    """Yield the positions that servos reported, in wire units."""
    replies: dict[str, ReplyParser] = {}
    for entry in lines:
        if isinstance(entry, ReceivedLine):
            parser = replies.setdefault(entry.bus, ReplyParser())
            for item in parser.feed(entry.data):
                if isinstance(item, Reply) and item.keyword == "QD" and item.servo_id is not None:
                    servo = servos.get((entry.bus, item.servo_id))
                    if servo is not None and isinstance(item.value, int):
                        yield entry.at_ns, servo, item.value


def _servo_deg(servo: Joint, wire: int) -> float:
    """Return the angle of an ideal servo."""
    return servo.joint_deg(wire / servo.model.wire_per_deg)


def _joint_state(at_ns: int, name: str, deg: float) -> bytes:
    """Return a JointState with one joint in CDR, the encoding of ROS 2."""
    angle_rad = math.radians(deg)
    seconds, rest_ns = divmod(at_ns, NS_PER_S)
    body = bytearray(struct.pack("<iI", seconds, rest_ns))
    _add_text(body, "")
    _add(body, "<I", 1)
    _add_text(body, name)
    _add(body, "<I", 1)
    _add(body, "<d", angle_rad)
    _add(body, "<II", 0, 0)  # Neither velocity nor effort.
    return CDR_HEAD + bytes(body)


def _add(body: bytearray, form: str, *values: float) -> None:
    """Append numbers at a multiple of their size."""
    size = struct.calcsize(form[:2])
    body += bytes(-len(body) % size)
    body += struct.pack(form, *values)


def _add_text(body: bytearray, text: str) -> None:
    data = text.encode() + b"\0"
    _add(body, "<I", len(data))
    body += data


def _events(lines: Sequence[LogLine]) -> Iterator[Message]:
    for entry in lines:
        content: object
        match entry:
            case HappenedLine():
                content = entry.event
            case RequestedLine():
                content = {"type": "Request", "text": entry.request.text}
            case PortLine():
                text = f"{entry.state} {entry.reason}".rstrip()
                content = {"type": "Port", "bus": entry.bus, "text": text}
            case _:
                continue
        yield entry.at_ns, EVENTS, msgspec.json.encode(content)
