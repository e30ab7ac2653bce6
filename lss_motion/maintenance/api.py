"""What looks after servos, for users: scan, identify, calibrate. `lss_motion` exports it.

found = lss.scan("/dev/ttyUSB0")                  # every servo: id, model, voltage, ...
with lss.connect(robot) as live:
    zeros = lss.calibrate(live, {"elbow": 90.0})  # it stands there, held by hand
    response = lss.identify(live, "elbow")        # it moves for half a minute
responses = lss.identify_log("show.log", robot)   # nothing moves
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lss_motion.errors import InputError, PlaybackError
from lss_motion.files.texts import known_names
from lss_motion.maintenance.identify.estimate import Identified
from lss_motion.maintenance.identify.trials import SPAN_DEG
from lss_motion.playing.discovery import ServoCondition
from lss_motion.playing.live import Live
from lss_motion.protocol.constants import Family
from lss_motion.robot.model import Bus, Robot

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.maintenance.identify.show_pieces import ShowRecording
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.log import Log
    from lss_motion.robot.model import Joint


def scan(
    port: str | None = None, *, robot: Robot | None = None, baud_bps: int | None = None
) -> list[ServoCondition]:
    """Return every servo that replies at `port`, or on the buses of `robot`; nothing moves.

    It asks at `baud_bps`, or at every rate. Raises `InputError` without port and robot, and
    `BusError` if a port cannot be opened.
    """
    from lss_motion.maintenance.survey import survey
    from lss_motion.playing.connection import connect, with_port

    if robot is not None:
        buses = with_port(robot, port).buses
    elif port is not None:
        buses = {"main": scanned_bus(port)}
    else:
        raise InputError("scan needs a port, such as /dev/ttyUSB0, or a robot")
    with connect(buses, robot=robot) as connection:
        return [look for bus in buses.values() for look in survey(connection, bus, baud_bps)]


def scanned_bus(port: str) -> Bus:
    """Return a bus of which nothing but the port is known."""
    return Bus(name="main", port=port, baud_bps=115200, firmware=370)


def identify(live: Live, joint: str, *, span_deg: float = SPAN_DEG) -> Identified:
    """Move a joint of an open robot for half a minute; return how its servo responds.

    It moves within `span_deg` of where it stands, within its range and limits. It must be free.
    Raises `InputError` for a joint that cannot be measured, and `PlaybackError` if it does not move
    as it should.
    """
    from lss_motion.maintenance.identify.estimate import identify as estimated

    measured = measurable(live.robot, joint)

    def use(connection: Connection) -> Experiment:
        experiment = make_experiment(connection, live.robot, measured, span_deg)
        connection.run(experiment)
        return experiment

    experiment = live.lend(use)
    if experiment.error is not None:
        raise experiment.error
    return estimated(measured, experiment.recording)


def measurable(robot: Robot, name: str) -> Joint:
    """Return the joint as it is measured, with the timed drive; raises `InputError`."""
    if name not in robot.joints:
        raise InputError(f"unknown joint {name!r}; {known_names(name, robot.joints)}")
    if robot.joints[name].model.family is Family.IO2:
        raise InputError(
            f"joint {name!r} is an RC servo of an LSS-2IO: it reports no position and "
            f"cannot be measured",
            path=robot.path,
        )
    return replace(robot.joints[name], drive="timed")


def make_experiment(
    connection: Connection, robot: Robot, joint: Joint, span_deg: float
) -> Experiment:
    """Ask the servo of a joint for its state; return the experiment that measures it from there."""
    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.maintenance.identify.trials import make_window
    from lss_motion.playing.player import handshake

    answers, _ = connection.examined([joint], robot)
    standing_deg = handshake.reported(joint, answers, "QD")
    assert standing_deg is not None, "`examined` raises without it"
    window = make_window(joint, standing_deg, span_deg)
    return Experiment(joint, robot, answers, window, standing_deg=standing_deg)


def identify_log(path: Path | str, robot: Robot) -> dict[str, Identified]:
    """Return how servos responded in the show of a log (`lss-play --log`), by joint.

    Joints that did not move enough are left out. Raises `InputError` for a file that is no log, or
    one without a move of this robot.
    """
    from lss_motion.maintenance.identify.show_fit import identify_from_show
    from lss_motion.playing.log import read_log

    found: dict[str, Identified] = {}
    for name, recording in recordings_of(read_log(Path(path)), robot).items():
        try:
            found[name] = identify_from_show(recording)
        except PlaybackError:
            continue
    return found


def recordings_of(log: Log, robot: Robot) -> dict[str, ShowRecording]:
    """Return what a log holds about each joint; raises `InputError` if that is nothing."""
    from lss_motion.maintenance.identify.show_pieces import LoggedBytes, recordings
    from lss_motion.playing.log import ReceivedLine, SentLine

    logged: Iterable[LoggedBytes] = (
        LoggedBytes(line.at_ns, line.bus, isinstance(line, SentLine), line.data)
        for line in log.lines
        if isinstance(line, SentLine | ReceivedLine)
    )
    found = recordings(logged, robot)
    if not found:
        raise InputError(f"holds no move of robot {robot.name!r}", path=log.path)
    return found


def calibrate(live: Live, pose_deg: Mapping[str, float]) -> dict[str, float]:
    """Return the `zero_deg` of joints that stand at `pose_deg` now, for the robot file.

    The direction of each joint is that of the file. Nothing moves and nothing is written. Raises
    `InputError` for an unknown joint and `BusError` if one does not reply.
    """
    from lss_motion.maintenance.settings import frame_of

    for name in pose_deg:
        if name not in live.robot.joints:
            raise InputError(f"unknown joint {name!r}; {known_names(name, live.robot.joints)}")
    standing_deg = live.read()
    zeros: dict[str, float] = {}
    for name, angle_deg in pose_deg.items():
        joint = live.robot.joints[name]
        frame = frame_of(
            joint,
            servo_deg=joint.servo_deg(standing_deg[name]),
            pose_deg=float(angle_deg),
            pushed_deg=None,
        )
        assert frame is not None, "only a push may be too small"
        zeros[name] = frame.zero_deg
    return zeros
