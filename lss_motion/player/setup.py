"""Before and after a show: which servos are there, may they do what the plan asks, and settings.

For the session, every servo gets the joint's own limits (AA, AD and SD), so that it keeps them
whatever it hears, and EM1, in which `D…T…` works; afterwards it gets back what it had.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.player.dialogue import Item
from lss_motion.program.compile import lines_use
from lss_motion.program.model import Move, Program, ramp_deg_s2
from lss_motion.protocol.codec import make_command, read_reply
from lss_motion.protocol.constants import BROADCAST_ID, Status, status_from
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.units import MS_PER_S, NS_PER_MS, NS_PER_US, line_time_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.queries import Questioner
    from lss_motion.robot.model import Bus, Joint, Robot

    Answers = Mapping[tuple[str, int, str], int | str | None]

QUESTIONS: Final = ("QMS", "QF", "Q", "QSD", "QAA", "QAD", "QEM", "QD")
"""Asked of every servo before anything moves; QD last, so that it is the most recent."""
ESSENTIAL: Final = ("QD",)
"""Without an answer to these the show does not start. A servo that answers them but not the
others is taken as it is: no document says which family answers all of them."""
SESSION_KEYWORDS: Final = ("EM", "AA", "AD", "SD")
APPROACH_LEAST_S: Final = 0.3
"""Even a servo that stands where it should is given this long: it may be limp."""
LATENCY_BAD_NS: Final = 5 * NS_PER_MS
"""A servo answers within 2 ms (lss_facts 2.2); what takes longer is an adapter's latency timer."""
LIMIT_SLACK_RATIO: Final = 0.999
"""Limits read back from a servo are rounded to its wire unit."""


def questions(joints: Iterable[Joint]) -> list[Item]:
    """Return what to ask before a show."""
    return [
        Item(bus=joint.bus, command=Command(joint.servo_id, keyword), is_question=True)
        for joint in joints
        for keyword in QUESTIONS
    ]


def check_answers(joints: Iterable[Joint], answers: Answers, robot: Robot) -> list[str]:
    """Return warnings about the servos found.

    Raises before anything moves: `BusError` for servos that do not answer, `InputError` where the
    robot file claims what the servo is not or may not do, `PlaybackError` for one in safe mode.
    """
    joints = list(joints)
    silent = [
        joint for joint in joints if any(stored(joint, answers, key) is None for key in ESSENTIAL)
    ]
    if silent:
        named = ", ".join(f"{j.name} (id {j.servo_id} on bus {j.bus!r})" for j in silent)
        raise BusError(
            f"no answer from {len(silent)} of {len(joints)} servos: {named}. Check power, wiring, "
            f"ids and the baud rate ({robot.buses[silent[0].bus].baud_bps} bps)",
            url=robot.buses[silent[0].bus].port,
        )
    warnings: list[str] = []
    for joint in joints:
        _check_joint(joint, answers, robot, warnings)
    return warnings


def _check_joint(joint: Joint, answers: Answers, robot: Robot, warnings: list[str]) -> None:
    bus = robot.buses[joint.bus]
    model = answers.get((joint.bus, joint.servo_id, "QMS"))
    if model is not None and not str(model).startswith(joint.model.name):
        raise InputError(
            f"joint {joint.name!r}: the robot file says {joint.model.name}, but servo "
            f"{joint.servo_id} is a {model}",
            path=robot.path,
        )
    firmware = answers.get((joint.bus, joint.servo_id, "QF"))
    if isinstance(firmware, int) and firmware != bus.firmware:
        warnings.append(
            f"joint {joint.name!r}: servo {joint.servo_id} has firmware {firmware}, the robot "
            f"file says {bus.firmware}"
        )
    status = answers.get((joint.bus, joint.servo_id, "Q"))
    if isinstance(status, int):
        state = status_from(status, joint.model.family, bus.firmware)
        if state in (Status.SAFE_MODE, Status.ERROR):
            raise PlaybackError(
                f"joint {joint.name!r}: servo {joint.servo_id} reports {state.value}; find the "
                f"cause, then RESET it",
                joint=joint.name,
            )
    needs = {"QSD": joint.speed_max_deg_s, "QAA": ramp_deg_s2(joint), "QAD": ramp_deg_s2(joint)}
    for keyword, needed in needs.items():
        allowed = stored(joint, answers, keyword)
        if allowed is not None and allowed < LIMIT_SLACK_RATIO * needed:
            unit = "deg/s" if keyword == "QSD" else "deg/s²"
            raise InputError(
                f"joint {joint.name!r}: the robot file asks for {needed:g} {unit}, but servo "
                f"{joint.servo_id} is set to {allowed:g} {unit} ({keyword[1:]}). Lower the limit "
                f"in the robot file, or configure the servo",
                path=robot.path,
            )


def check_latency(buses: Mapping[str, Bus], questioners: Mapping[str, Questioner]) -> list[str]:
    """Return a warning for every port where each answer so far came later than servos answer."""
    warnings = []
    for name, questioner in questioners.items():
        least_ns, port = questioner.least_wait_ns, buses[name].port
        if least_ns is None or least_ns < LATENCY_BAD_NS:
            continue
        device = port.rpartition("/")[2]
        warnings.append(
            f"port {port}: answers come {least_ns / NS_PER_MS:.0f} ms late, so there are fewer "
            f"readings: the USB adapter holds them back. Linux: `echo 1 | sudo tee "
            f"/sys/bus/usb-serial/devices/{device}/latency_timer`; Windows: device manager, port, "
            f"advanced, latency timer 1 ms"
        )
    return warnings


def stored(joint: Joint, answers: Answers, keyword: str) -> float | None:
    """Return the number that a servo answered to `keyword`, in physical units, if it did."""
    value = answers.get((joint.bus, joint.servo_id, keyword))
    if not isinstance(value, int):
        return None
    said = read_reply(joint.model.family, Reply(joint.servo_id, keyword, value))
    return float(said.value) if said is not None and isinstance(said.value, int | float) else None


def session_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the settings for the show. A servo that did not say what it has gets none of it."""
    orders = []
    for joint in joints:
        ramp = float(ramp_deg_s2(joint))
        wanted = {"EM": 1.0, "AA": ramp, "AD": ramp, "SD": joint.speed_max_deg_s}
        orders += [
            _order(joint, make_command(joint.model.family, joint.servo_id, keyword, value))
            for keyword, value in wanted.items()
            if stored(joint, answers, f"Q{keyword}") is not None
        ]
        orders += [
            _order(joint, Command(joint.servo_id, keyword, value))
            for keyword, value in joint.settings.items()
        ]
    return orders


def restoring_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return what gives every servo back the settings that it had."""
    return [
        _order(joint, Command(joint.servo_id, keyword, had))
        for joint in joints
        for keyword in (*SESSION_KEYWORDS, *joint.settings)
        if isinstance(had := answers.get((joint.bus, joint.servo_id, f"Q{keyword}")), int)
    ]


def _order(joint: Joint, command: Command) -> Item:
    return Item(bus=joint.bus, command=command, is_question=False)


def settings_questions(joints: Iterable[Joint]) -> list[Item]:
    """Return what to ask so that the `settings` of the robot file can be undone."""
    return [
        Item(bus=joint.bus, command=Command(joint.servo_id, f"Q{keyword}"), is_question=True)
        for joint in joints
        for keyword in joint.settings
    ]


def approach(
    robot: Robot, standing_deg: Mapping[str, float], start_deg: Mapping[str, float]
) -> Program:
    """Return the program that takes every joint from where it stands to where the show starts.

    One move a joint, all of the same duration: the servo's own ramps keep the limits, and no
    joint is faster than `approach_speed_deg_s`. `standing_deg` are servo angles, `start_deg`
    joint angles.
    """
    longest_s = APPROACH_LEAST_S
    slowest_ramp_s = 0.0
    for name, joint_deg in start_deg.items():
        joint = robot.joints[name]
        speed_deg_s = min(robot.approach_speed_deg_s, joint.speed_max_deg_s)
        way_deg = abs(joint.servo_deg(joint_deg) - standing_deg[name])
        longest_s = max(longest_s, way_deg / speed_deg_s)
        slowest_ramp_s = max(slowest_ramp_s, speed_deg_s / ramp_deg_s2(joint))
    moves, due_us = [], dict.fromkeys(robot.buses, 0)
    for name, joint_deg in start_deg.items():
        joint = robot.joints[name]
        move = Move(
            due_us=due_us[joint.bus],
            bus=joint.bus,
            servo_id=joint.servo_id,
            target_wire=round(joint.servo_deg(joint_deg) * joint.model.wire_per_deg),
            duration_ms=math.ceil(MS_PER_S * longest_s),
        )
        moves.append(move)
        size_ns = line_time_ns(len(move.data), robot.buses[joint.bus].baud_bps)
        due_us[joint.bus] += -(-size_ns // NS_PER_US)
    moves.sort(key=lambda move: move.due_us)
    return Program(
        name="approach",
        robot=robot.name,
        robot_path=robot.path,
        moves=tuple(moves),
        duration_s=longest_s + slowest_ramp_s + 1e-6 * max(due_us.values(), default=0),
        start_deg={n: robot.joints[n].joint_deg(standing_deg[n]) for n in start_deg},
        tolerance_deg=0.0,
        line_use=lines_use(moves, robot),
    )


def safe_bytes(robot: Robot, *, is_limp: bool = False) -> dict[str, bytes]:
    """Return, per bus, the last bytes of every run: hold where it is, or go limp (design 8)."""
    command = Command(BROADCAST_ID, "L" if is_limp else "H")
    return dict.fromkeys(robot.buses, encode(command))
