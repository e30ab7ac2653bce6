"""What looks after servos, for users: scan, identify, calibrate. `lss_motion` exports it.

found = lss.scan("/dev/ttyUSB0")                  # every servo: id, model, voltage, ...
with lss.connect(robot) as live:
    zeros = lss.calibrate(live, {"elbow": 90.0})  # it stands there, held by hand
    response = lss.identify(live, "elbow")        # it moves for half a minute
responses = lss.identify_log("show.log", robot)   # nothing moves

`read_settings` and `write_settings` talk to the servos for `lss-motion configure`. Every write is
read back. A servo with changes that act after a RESET is restarted, and its settings are read once
more. `change_id` and `change_baud` write a setting that moves the servo to another address, and
look for it there.
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.files.texts import known_names
from lss_motion.maintenance import settings
from lss_motion.maintenance.identify.estimate import Identified
from lss_motion.maintenance.identify.trials import SPAN_DEG
from lss_motion.maintenance.settings import Target
from lss_motion.maintenance.survey import doubtful_text, query_each
from lss_motion.playing.discovery import ServoCondition
from lss_motion.playing.live import Live
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.constants import RESET_S, Family
from lss_motion.protocol.framing import Command
from lss_motion.robot.mechanisms import careful_servo
from lss_motion.robot.model import Bus, Robot

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.maintenance.identify.show_pieces import ShowRecording
    from lss_motion.maintenance.settings import SettingChange, Values
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoIdentity
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


def _joint(robot: Robot, name: str) -> Joint:
    if name not in robot.joints:
        raise InputError(f"unknown joint {name!r}; {known_names(name, robot.joints)}")
    return robot.joints[name]


def require_own_servo(robot: Robot, name: str, what: str) -> None:
    """Raise `InputError` for a joint that is not its servo, and so has no zero of its own."""
    if any(name in one.joints for one in robot.mechanisms.values()):
        raise InputError(
            f"{what}: a ratio, a linkage or a mechanism stands between joint {name!r} and its "
            f"servo; measure it as the guide head-neck.md says",
            path=robot.path,
        )


def measurable(robot: Robot, name: str) -> Joint:
    """Return the servo of a joint as it is measured, with the timed drive; raises `InputError`.

    Behind a ratio or a linkage it is the servo, in degrees of an ideal one; it stays within what
    range, speed and acceleration of the joint leave it everywhere.
    """
    if _joint(robot, name).model.family is Family.IO2:
        raise InputError(
            f"joint {name!r} is an RC servo of an LSS-2IO: it reports no position and "
            f"cannot be measured",
            path=robot.path,
        )
    mechanism = next((one for one in robot.mechanisms.values() if name in one.joints), None)
    if mechanism is None:
        return replace(robot.joints[name], drive="timed")
    if mechanism.servos != (name,):
        raise InputError(
            f"joint {name!r} is moved by several servos ({', '.join(mechanism.servos)}), which "
            f"must not move alone; take the rods off, and measure each by a robot file in which it "
            f"is a joint",
            path=robot.path,
        )
    return replace(careful_servo(mechanism, robot), drive="timed")


def make_experiment(
    connection: Connection, robot: Robot, joint: Joint, span_deg: float
) -> Experiment:
    """Ask the servo of a joint for its state; return the experiment that measures it from there."""
    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.maintenance.identify.trials import make_window
    from lss_motion.playing.player import handshake

    robot = robot.servo_robot
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
    robot.require_servos("identify from the log of a show")
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

    joints = {name: _joint(live.robot, name) for name in pose_deg}
    for name in joints:
        require_own_servo(live.robot, name, "calibrate")
    standing_deg = live.read()
    zeros: dict[str, float] = {}
    for name, angle_deg in pose_deg.items():
        joint = joints[name]
        frame = frame_of(
            joint,
            servo_deg=joint.servo_deg(standing_deg[name]),
            pose_deg=float(angle_deg),
            pushed_deg=None,
        )
        assert frame is not None, "only a push may be too small"
        zeros[name] = frame.zero_deg
    return zeros


# ---- settings of servos

RESET_WAIT_S: Final = RESET_S + 0.25
"""No command is sent for this time after a RESET: the servo receives nothing for 1.25 s
(FACTS.md R4), and libraries wait 1.5 s and more."""
ROUNDS: Final = 4
"""Attempts until a value is read or written: a command can be lost, a servo can restart."""
SETTLE_S: Final = 0.02
"""Time between writing and reading back: twice the 10 ms that careful users leave (FACTS.md R9)."""


def targets_at(connection: Connection, bus: str, names: Mapping[int, str]) -> list[Target]:
    """Return the servos at these ids of a bus, with the names that people use for them.

    Raises `BusError` if no servo or more than one replies at an id.
    """
    found = {present.servo_id: present for present in servos_at(connection, bus, names)}
    answers = connection.ask(
        Item(bus=bus, command=Command(servo_id, "QF"))
        for servo_id, present in found.items()
        if present.family is not Family.IO2
    )
    targets = []
    for servo_id, name in names.items():
        present, firmware = found[servo_id], answers.get((bus, servo_id, "QF"))
        targets.append(
            Target(
                name=name,
                bus=bus,
                servo_id=servo_id,
                model=present.model,
                family=present.family,
                firmware=firmware if isinstance(firmware, int) else None,
            )
        )
    return targets


def servos_at(connection: Connection, bus: str, ids: Iterable[int]) -> list[ServoIdentity]:
    """Return the servo at each of these ids, in their order.

    Raises `BusError` if no servo or more than one replies at an id.
    """
    ids = list(ids)
    found: dict[int, ServoIdentity] = {}
    for wait_s in (0.0, RESET_WAIT_S):  # A reply can be lost, or a servo restarts.
        left = {servo_id: "" for servo_id in ids if servo_id not in found}
        if left:
            connection.wait(wait_s)
        found |= {present.servo_id: present for present in query_each(connection, bus, left)}
    port, baud_bps = connection.buses[bus].port, connection.buses[bus].baud_bps
    missing = [str(servo_id) for servo_id in ids if servo_id not in found]
    if missing:
        raise BusError(
            f"no servo replies at id {', '.join(missing)} on {port} at {baud_bps} bps; "
            f"`lss-motion scan {port}` lists the servos",
            url=port,
        )
    for servo_id in ids:
        if found[servo_id].is_shared:
            raise BusError(
                f"several servos share id {servo_id}; connect one of them alone",
                url=port,
            )
        if found[servo_id].is_doubtful:
            raise BusError(doubtful_text(servo_id), url=port)
    return [found[servo_id] for servo_id in ids]


def read_settings(
    connection: Connection, targets: Sequence[Target], *, is_session: bool = False
) -> dict[str, Values]:
    """Return the settings of every target by its name, without those that got no reply.

    A servo that sent some replies is queried again for the rest, because a reply can be lost.
    """
    left = {target.name: dict(target.rows(is_session=is_session)) for target in targets}
    found: dict[str, Values] = {target.name: {} for target in targets}
    for _ in range(ROUNDS):
        answers = connection.ask(
            item
            for target in targets
            for item in settings.questions(target, left[target.name], is_session=is_session)
        )
        for target in targets:
            fresh = settings.values(target, left[target.name], answers)
            found[target.name] |= fresh
            rows = left[target.name].items()
            left[target.name] = {name: row for name, row in rows if fresh and name not in fresh}
        if not any(left.values()):
            break
    return found


def read_whole(connection: Connection, targets: Sequence[Target]) -> dict[str, Values]:
    """Return all stored settings; raise `BusError` if one cannot be read."""
    found = read_settings(connection, targets)
    for target in targets:
        missing = [name for name in target.rows(is_session=False) if name not in found[target.name]]
        if missing:
            raise BusError(
                f"{target.name} (id {target.servo_id}) did not report all settings: "
                f"{', '.join(missing)} missing. Check plugs and power, then try again"
            )
    return found


def write_settings(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool = False,
) -> list[SettingChange]:
    """Write the settings that differ from `wanted` until they read back; return the changes.

    A servo with a change that acts after a RESET is restarted, and its settings must read back once
    more, unless it went to another baud rate or into RC mode. Raises `BusError` for settings that
    a servo does not keep.
    """
    needed = differing(connection, targets, wanted, is_session=is_session)
    done, unread = list(needed), [c for c in needed if not c.row.queries]
    connection.ask(settings.limp_orders(needed))
    for _ in range(ROUNDS):
        connection.ask(settings.orders(needed, is_session=is_session))
        connection.wait(SETTLE_S)
        needed = differing(connection, targets, wanted, is_session=is_session)
        needed = [change for change in needed if change not in unread]
        if not needed:
            break
        connection.wait(RESET_WAIT_S)
    restarted = {c.target.name: c.target for c in done if c.row.needs_reset and not is_session}
    if restarted and not needed:
        reset(connection, list(restarted.values()))
        gone = {c.target.name for c in done if c.row.name in settings.LEAVING}
        again = [target for name, target in restarted.items() if name not in gone]
        needed = differing(connection, again, wanted, is_session=False)
    if needed:
        kept = "; ".join(
            f"{c.target.name}: {c.row.name} is {settings.value_text(c.row, c.had)}, not "
            f"{settings.value_text(c.row, c.wanted)}"
            for c in needed
        )
        raise BusError(f"servos did not keep all settings: {kept}. The others are kept; try again")
    return done


def differing(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool,
) -> list[SettingChange]:
    """Return the settings that differ from `wanted`. A silent servo gets time to restart first."""
    had = read_settings(connection, targets, is_session=is_session)
    silent = [target for target in targets if not had[target.name]]
    if silent:
        connection.wait(RESET_WAIT_S)
        had |= read_settings(connection, silent, is_session=is_session)
    for target in silent:
        if not had[target.name]:
            raise BusError(
                f"{target.name} (id {target.servo_id}) no longer replies; check plugs and "
                f"power, then try again"
            )
    return [
        change
        for target in targets
        for change in settings.changes(target, had[target.name], wanted.get(target.name, {}))
    ]


def reset(connection: Connection, targets: Sequence[Target]) -> None:
    """Restart servos and wait until they receive commands again. They go limp."""
    items = [
        Item(bus=target.bus, command=Command(target.servo_id, "RESET"))
        for target in targets
        if target.family is not Family.IO2
    ]
    connection.restart(items, RESET_WAIT_S)


def change_id(connection: Connection, bus: str, old_id: int, new_id: int) -> ServoIdentity:
    """Give the only servo at `old_id` another id; return it as it answers there.

    Raises `InputError` if the id is in use, `BusError` if no servo or more than one replies, or if
    the servo keeps its old id.
    """
    (present,) = servos_at(connection, bus, [old_id])
    command = make_command(present.family, old_id, "CID", new_id)
    for other in query_each(connection, bus, {new_id: ""}):
        raise InputError(
            f"id {new_id} is used by a {other.model or 'servo'}; choose another, or connect the "
            f"servo with id {old_id} alone"
        )
    for _ in range(ROUNDS):
        connection.ask([Item(bus=bus, command=command)])
        connection.wait(SETTLE_S)
        if present.family is not Family.IO2:
            reset_item = Item(bus=bus, command=Command(old_id, "RESET"))
            connection.restart([reset_item], RESET_WAIT_S)
        found = query_each(connection, bus, {new_id: "", old_id: ""})
        if [p.servo_id for p in found] == [new_id] and found[0].model == present.model:
            return found[0]
        if not any(p.servo_id == old_id for p in found):
            connection.wait(RESET_WAIT_S)
    raise BusError(
        f"the {present.model} did not change from id {old_id} to {new_id}; switch it off "
        f"and on, then `lss-motion scan {connection.buses[bus].port}`"
    )


def change_baud(
    connection: Connection, bus: str, servos: Sequence[ServoIdentity], baud_bps: int
) -> list[int]:
    """Set servos of a bus and its port to another baud rate; return the ids without a reply there.

    Raises `ProtocolError` or `InputError` before anything is written if a servo cannot change.
    """
    fixed = [str(p.servo_id) for p in servos if p.family is Family.LSS_PRO]
    if fixed:
        raise InputError(f"LSS-PRO servos have no baud rate to set (ids {', '.join(fixed)})")
    firmware = {
        servo_id: value
        for (_, servo_id, _), value in connection.ask(
            Item(bus=bus, command=Command(p.servo_id, "QF"))
            for p in servos
            if p.family is Family.LSS
        ).items()
    }
    smart: list[Command] = []
    boards: list[Command] = []
    for present in servos:
        if present.family is Family.IO2 and not present.model.endswith("-LED"):
            continue
        known = firmware.get(present.servo_id)
        command = make_command(
            present.family,
            present.servo_id,
            "CB",
            baud_bps,
            firmware=known if isinstance(known, int) else None,
        )
        (boards if present.family is Family.IO2 else smart).append(command)
    for _ in range(2):  # No reply confirms it; the second covers a lost command.
        connection.ask(Item(bus=bus, command=command) for command in smart)
        connection.wait(SETTLE_S)
    # A board changes its rate at once, so it is the last to get its command at the old rate.
    last = [Command(command.servo_id, "RESET") for command in smart] + boards
    connection.ask(Item(bus=bus, command=command) for command in last)
    connection.wait(RESET_WAIT_S)
    connection.set_baud(bus, baud_bps)
    there = {p.servo_id for p in query_each(connection, bus, {p.servo_id: "" for p in servos})}
    return [present.servo_id for present in servos if present.servo_id not in there]
