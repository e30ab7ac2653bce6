"""What the servos answered before anything moves, compared with the robot file and the program.

`queries` and `stored_queries` are what is asked. `refusals` are the reasons why nothing may move,
each with the queries whose answers show it, so that `preflight` can ask them again: one answer on a
bus without checksums proves nothing. `check` raises them, and returns the warnings and the table of
the servos for a person.

A robot file states the gyre, the origin and the angular range of a servo with `stored:`; what it
does not state is the value from the factory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from lss_motion.errors import BusError, InputError, LssMotionError, PlaybackError
from lss_motion.playing.player.echo import judge_echo
from lss_motion.playing.player.events import Checked, CheckedServo, Warned
from lss_motion.playing.player.handshake import (
    Item,
    query,
    reported,
    settings_queries,
    silent_error,
    standing_deg,
)
from lss_motion.playing.player.health import STATUS_CAUSES, STATUS_TEXTS, hot_text, low_voltage_text
from lss_motion.protocol.codec import language_table, storable, stored_wire
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.table import Suffix
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.robot.profile import ramp_setting_deg_s2
from lss_motion.robot.servo_models import FILTER_FIRMWARE_MIN, model_mismatch_text
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.playing.player.query_tracker import QueryTracker
    from lss_motion.robot.model import Bus, Joint, Robot, Sensor
    from lss_motion.robot.on_fault import Escalations

    Address = tuple[str, int]
    """Bus and servo id."""


QUERIES: Final = ("QMS", "QF", "Q", "QSD", "QAA", "QAD", "QEM", "QV", "QT", "QD")
"""Queries to every servo before anything moves. Without an answer to QD the show does not start. A
servo that answers QMS and QD but not the others is driven: no document says which family answers
all. A servo that does not answer the first query counts as silent (`handshake.TRIES`), so that
is QMS, which all three documents have."""
FILTER_QUERIES: Final = ("QFPC", "QIPE")
"""Further queries to streamed servos. IPE makes the filter step by itself (FACTS.md M8); a servo
that does not answer QIPE is assumed to have the factory setting, which does so."""
FILTER_ESSENTIAL: Final = ("QD", "QEM", "QFPC")
IO2_QUERIES: Final = ("QMS", "QG", "QD")
"""An RC servo on a 2IO answers no more, and QD is only its last command (FACTS.md B8, B10)."""
FRAME: Final = ("G", "O", "AR")
"""Gyre, origin and angular range define what an angle or a pulse means (FACTS.md C12, C13)."""
STORED_LIMITS: Final = ("SD", "AA", "AD", "EM")
"""The settings that limit the speed of a servo that restarts."""
OUTSIDE_DEG: Final = 1.0
"""No warning for less outside of the range: a load may have pulled the joint there. Chosen."""
LATENCY_BAD_NS: Final = 5 * NS_PER_MS
"""A servo answers within 2 ms (FACTS.md W14); an adapter's latency timer makes it longer."""
LIMIT_SLACK_RATIO: Final = 0.999
"""Limits read back from a servo are rounded to its wire unit."""
NAMED_MAX: Final = 2
"""So many servos are named in a text about many. Chosen."""
MOVING: Final = (
    Status.FREE_MOVING,
    Status.ACCELERATING,
    Status.TRAVELING,
    Status.DECELERATING,
)


# ---- what is asked


def queries(joints: Iterable[Joint], led_joints: Container[str] = ()) -> list[Item]:
    """Return the queries before a show that changes the LED colours of `led_joints`.

    Queries that only some servos support come last.
    """
    joints = list(joints)
    known = [
        query(joint, keyword)
        for joint in joints
        for keyword in _asked_of(joint)
        if keyword in language_table(joint.model.language).by_keyword
    ]
    return known + frame_queries(joints) + settings_queries(joints, led_joints)


def _asked_of(joint: Joint) -> tuple[str, ...]:
    match joint.drive:
        case "stepped":
            return IO2_QUERIES
        case "streamed":
            return (*QUERIES, *FILTER_QUERIES)
        case _:
            return QUERIES


def frame_queries(joints: Iterable[Joint]) -> list[Item]:
    """Return the queries for the gyre, the origin and the angular range of smart servos.

    One answer is enough where it is what the robot file states.
    """
    return [Item.to(joint, f"Q{name}") for joint in joints for name in expected_frame(joint)]


def stored_queries(joints: Iterable[Joint]) -> list[Item]:
    """Return the queries for the settings with which a servo would restart (suffix 1: FACTS.md C4).

    The answers have the keywords of the present settings, so they need a dialogue of their own.
    """
    return [
        Item.to(joint, f"Q{name}", 1)
        for joint in joints
        for name, row in storable(joint.model.language).items()
        if name in (*FRAME, *STORED_LIMITS) and Suffix.CONFIGURED in (row.suffixes or {}).values()
    ]


def sensor_queries(program: Program, robot: Robot) -> list[Item]:
    """Return a query to every sensor that the show waits for."""
    return [Item.to(sensor, "QA") for sensor in _sensors(program, robot)]


# ---- what refuses


class Refusal(NamedTuple):
    """Why nothing may move, and the queries to one servo whose answers show it.

    With `is_stored` they are queries for stored settings.
    """

    joint: Joint
    keywords: tuple[str, ...]
    error: LssMotionError
    is_frame: bool = False
    is_stored: bool = False
    is_warning: bool = False
    """It is a warning, and nothing more."""


def refusals(
    joints: Iterable[Joint],
    answers: Answers,
    stored: Answers,
    robot: Robot,
    show: Escalations | None = None,
) -> list[Refusal]:
    """Return all reasons why these joints may not move; `show` are the escalations of the show."""
    return [
        refusal
        for joint in joints
        for refusal in (
            *_model_refusals(joint, answers, robot),
            *_drive_refusals(joint, answers, robot),
            *_frame_refusals(joint, answers, stored, robot),
            *_condition_refusals(joint, answers, robot, show or {}),
            *_limit_refusals(joint, answers, robot),
        )
    ]


def _model_refusals(joint: Joint, answers: Answers, robot: Robot) -> Iterator[Refusal]:
    model = answers.get((joint.bus, joint.servo_id, "QMS"))
    if model is not None and not str(model).startswith(joint.model.name):
        error = InputError(
            f"joint {joint.name!r}: {model_mismatch_text(joint, str(model))}",
            path=robot.path,
            line=joint.lines.get("model"),
        )
        yield Refusal(joint, ("QMS",), error)
    firmware = reported_firmware(joint, answers)
    assumed = robot.buses[joint.bus].firmware_of(joint.model.family)
    if firmware is not None and firmware != assumed:
        other = InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} has firmware {firmware}, the robot "
            f"file says {assumed}"
        )
        yield Refusal(joint, ("QF",), other, is_warning=True)


def _drive_refusals(joint: Joint, answers: Answers, robot: Robot) -> Iterator[Refusal]:
    """Yield why a servo cannot be driven as the program requires."""
    if joint.drive == "stepped" and reported(joint, answers, "QG") == -1.0:
        error = InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} has a gyre of -1, with which an LSS-2IO "
            f"says nonsense about where it is. Set its gyre to 1 (CG1), and `direction: -1` here",
            path=robot.path,
        )
        yield Refusal(joint, ("QG",), error)
    unknown = [key[1:] for key in FILTER_ESSENTIAL if reported(joint, answers, key) is None]
    if joint.drive == "streamed" and unknown:
        firmware = answers.get((joint.bus, joint.servo_id, "QF"))
        is_old = isinstance(firmware, int) and firmware < FILTER_FIRMWARE_MIN
        why = f"has firmware {firmware}" if is_old else f"does not say its {' and '.join(unknown)}"
        error = InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} {why}, so it cannot be streamed and set "
            f"back. That needs an LSS with firmware {FILTER_FIRMWARE_MIN} or later; otherwise use "
            f"`drive: timed`",
            path=robot.path,
            line=joint.lines.get("drive"),
        )
        yield Refusal(joint, tuple(f"Q{word}" for word in unknown), error)


def expected_frame(joint: Joint) -> dict[str, int]:
    """Return the gyre, origin and angular range that the robot file states, as wire values.

    An RC servo has a gyre only, which must be 1.
    """
    if joint.model.family is Family.IO2:
        return {}
    rows = storable(joint.model.language)
    return {
        name: wire
        for name in FRAME
        if name in rows and (wire := _expected(joint, name)) is not None
    }


def _expected(joint: Joint, name: str) -> int | None:
    if name in joint.stored:
        return stored_wire(joint.model.language, name, joint.stored[name])
    return storable(joint.model.language)[name].default


FRAME_TEXTS: Final = {
    "G": "gyre (G) {had:g}, the robot file says {wanted:g}: it would turn the other way",
    "O": "origin (O) {had:g} deg, the robot file says {wanted:g} deg: all its angles would be off",
    "AR": "angular range (AR) {had:g} deg, the robot file says {wanted:g} deg",
}


def frame_problems(joints: Iterable[Joint], answers: Answers, robot: Robot) -> list[str]:
    """Return where the gyre, the origin or the range of a servo is not that of the robot file.

    `answers` are those to `frame_queries`.
    """
    refused = (one for joint in joints for one in _frame_refusals(joint, answers, {}, robot))
    return [refusal.error.reason for refusal in refused if isinstance(refusal.error, InputError)]


def _frame_refusals(
    joint: Joint, answers: Answers, stored: Answers, robot: Robot
) -> Iterator[Refusal]:
    """Yield one refusal for the present frame of a servo, and one for its stored frame."""
    rows, wanted = storable(joint.model.language), expected_frame(joint)
    for source, is_stored in ((answers, False), (stored, True)):
        had = {
            name: value
            for name in wanted
            if isinstance(value := source.get((joint.bus, joint.servo_id, f"Q{name}")), int)
            and value != wanted[name]
        }
        if not had:
            continue
        texts = [
            FRAME_TEXTS[name].format(
                had=rows[name].physical(value), wanted=rows[name].physical(wanted[name])
            )
            for name, value in had.items()
        ]
        kept = "stored settings, with which it would restart: " if is_stored else ""
        error = InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} has {kept}{'; '.join(texts)}. "
            f"{_frame_remedy(joint, had, stored, robot)}",
            path=robot.path,
            line=next(
                (joint.lines[key] for name in had if (key := f"stored.{name}") in joint.lines),
                joint.lines.get("id"),
            ),
        )
        keywords = tuple(f"Q{name}" for name in had)
        yield Refusal(joint, keywords, error, is_frame=True, is_stored=is_stored)
        return


def _frame_remedy(joint: Joint, had: Mapping[str, int], stored: Answers, robot: Robot) -> str:
    """Return how to mend a frame: in the servo, or in the robot file."""
    rows, path = storable(joint.model.language), robot.path or "ROBOT"
    address = (joint.bus, joint.servo_id)
    if all(stored.get((*address, f"Q{name}")) == _expected(joint, name) for name in had):
        return (
            f"It has that until it restarts: lss-motion send --robot {path} --id "
            f"{joint.servo_id} RESET"
        )
    sets = " ".join(f"--set {name}={_value(joint, name)}" for name in had)
    lines = ", ".join(f"{name}: {rows[name].physical(value):g}" for name, value in had.items())
    return (
        f"If the robot file is right: lss-motion configure {path} --joint {joint.name} {sets}. If "
        f"the servo is right, write `stored: {{{lines}}}` at this joint"
        f"{_units_remedy(joint) if had.keys() & SCALED else ''}"
    )


SCALED: Final = frozenset({"O", "AR"})
"""The settings of a frame that are angles, in units that an LSS-PRO may have otherwise."""


def _units_remedy(joint: Joint) -> str:
    """Return how a value in another unit is mended: stored anew, it would be multiplied."""
    if joint.model.family is not Family.LSS_PRO:
        return ""
    return (
        ". An LSS-PRO may count in other units: then leave it as it is, write `units` into the "
        "robot file, and play with --careful"
    )


def _value(joint: Joint, name: str) -> str:
    wire = _expected(joint, name)
    assert wire is not None, "frames have numbers"
    return f"{storable(joint.model.language)[name].physical(wire):g}"


def _condition_refusals(
    joint: Joint, answers: Answers, robot: Robot, show: Escalations
) -> Iterator[Refusal]:
    """Yield what is wrong with a servo: as a warning if `on_fault` has no other step for it."""
    status = status_of(joint, answers)
    if status in (Status.SAFE_MODE, Status.ERROR):
        error = PlaybackError(
            f"joint {joint.name!r}: servo {joint.servo_id} reports {status.value}; find the "
            f"cause, then RESET it",
            joint=joint.name,
        )
        yield Refusal(joint, ("Q",), error)
        return
    if status in MOVING and joint.model.family is Family.LSS:
        error = PlaybackError(
            f"joint {joint.name!r}: servo {joint.servo_id} moves already ({status.value}): another "
            f"program drives it, or an earlier move goes on. Begin when it rests; "
            f"`lss-motion send --id {joint.servo_id} H` halts it",
            joint=joint.name,
        )
        yield Refusal(joint, ("Q",), error)
    for cause, keyword, text in _conditions(joint, answers):
        is_warning = not set(robot.escalation(cause, joint, show)) - {FaultStep.WARN}
        ending = "" if is_warning else f". Nothing moves, as `on_fault` has it for {cause}"
        error = PlaybackError(f"joint {joint.name!r} {text}{ending}", joint=joint.name)
        yield Refusal(joint, (keyword,), error, is_warning=is_warning)


def _conditions(joint: Joint, answers: Answers) -> Iterator[tuple[Cause, str, str]]:
    """Yield cause, query and text of every fault that the answers of a servo show."""
    status = status_of(joint, answers)
    if status in (Status.STUCK, Status.BLOCKED):
        cause = STATUS_CAUSES[status]
        yield cause, "Q", STATUS_TEXTS[cause]
    voltage_v, temperature_c = (reported(joint, answers, key) for key in ("QV", "QT"))
    if voltage_v is not None and voltage_v < joint.voltage_min_v:
        yield Cause.LOW_VOLTAGE, "QV", low_voltage_text(joint, voltage_v)
    if temperature_c is not None and temperature_c > joint.temperature_max_c:
        yield Cause.HOT, "QT", hot_text(joint, temperature_c)


def _limit_refusals(joint: Joint, answers: Answers, robot: Robot) -> Iterator[Refusal]:
    """Yield the limits of a servo that are below those of its joint."""
    needs: dict[str, float] = {"QSD": joint.speed_max_deg_s}
    if joint.drive == "timed":
        needs |= dict.fromkeys(("QAA", "QAD"), ramp_setting_deg_s2(joint))
    for keyword, needed in needs.items():
        allowed = reported(joint, answers, keyword)
        if allowed is not None and allowed < LIMIT_SLACK_RATIO * needed:
            is_speed = keyword == "QSD"
            unit = "deg/s" if is_speed else "deg/s²"
            error = InputError(
                f"joint {joint.name!r}: the robot file requires {needed:g} {unit}, but servo "
                f"{joint.servo_id} is set to {allowed:g} {unit} ({keyword[1:]}). Lower the limit "
                f"in the robot file, or configure the servo{_units_remedy(joint)}",
                path=robot.path,
                line=joint.lines.get("speed_max_deg_s" if is_speed else "accel_max_deg_s2"),
            )
            yield Refusal(joint, (keyword,), error)


def combined(found: Sequence[Refusal]) -> LssMotionError:
    """Return one error for all refusals: wrong files or servos first, then their condition."""
    errors = [refusal.error for refusal in found]
    wrong = [error for error in errors if isinstance(error, InputError)]
    if wrong:
        first = wrong[0]
        return InputError(first.reason, path=first.path, line=first.line, more=wrong[1:])
    joint = found[0].joint.name
    return PlaybackError("\n".join(dict.fromkeys(map(str, errors))), joint=joint)


# ---- the limits with which a servo restarts


def stored_limits(joint: Joint) -> dict[str, int]:
    """Return the largest values with which a servo may restart: those of its joint.

    They are wire values by the name of the setting. A servo that is driven by ramps must also
    restart with them (EM1). An RC servo on a 2IO has no limits.
    """
    if joint.model.family is Family.IO2:
        return {}
    rows, ramp = storable(joint.model.language), ramp_setting_deg_s2(joint)
    limits = {"SD": joint.speed_max_deg_s, "AA": ramp, "AD": ramp}
    wires = {name: rows[name].wire(value) for name, value in limits.items() if name in rows}
    return wires | ({"EM": 1} if joint.drive == "timed" and "EM" in rows else {})


def stored_excesses(joints: Iterable[Joint], stored: Answers) -> list[str]:
    """Return a text for each servo that stores higher limits than its joint, or reports none."""
    return [text for joint in joints if (text := _stored_excess(joint, stored))]


STORED_NAMES: Final = {"SD": "speed", "AA": "acceleration", "AD": "deceleration"}
"""What a stored limit is, for a person."""


def _stored_excess(joint: Joint, stored: Answers) -> str:
    rows, parts = storable(joint.model.language), []
    for name, allowed in stored_limits(joint).items():
        value = stored.get((joint.bus, joint.servo_id, f"Q{name}"))
        row = rows[name]
        if name == "EM":
            parts += ["EM 0 (no ramps)"] if value == 0 else []
        elif not isinstance(value, int):
            parts.append(f"{name} unknown")
        elif value > allowed:
            what = f"{STORED_NAMES[name]} {row.physical(value):g} {row.unit} ({name})"
            parts.append(f"{what}, the joint allows {row.physical(allowed):g}")
    return f"{joint.name} (servo {joint.servo_id}): {'; '.join(parts)}" if parts else ""


def check_stored_limits(
    joints: Sequence[Joint],
    stored: Answers,
    robot: Robot,
    *,
    has_feedback: bool,
    is_forced: bool,
) -> tuple[list[str], list[str]]:
    """Return warnings and notes about the limits with which the servos would restart.

    With feedback a restart is noticed, and the servo gets its limits again before it moves; so
    higher stored limits are worth a note. Without feedback nothing notices it: then they raise
    `InputError`, unless a person forces the show or all servos are simulated.
    """
    excesses = stored_excesses(joints, stored)
    is_simulated = all(bus.is_simulated for bus in robot.buses.values())
    if not excesses or (has_feedback and is_simulated):
        return [], []
    more = f"; and {len(excesses) - NAMED_MAX} more" if len(excesses) > NAMED_MAX else ""
    which = "; ".join(excesses[:NAMED_MAX]) + more
    remedy = f"`lss-motion configure {robot.path or 'ROBOT'} --limits` stores those of the joints"
    if has_feedback:
        note = "a servo that restarts moves with its stored limits until that is noticed, and they"
        return [], [f"{note} are higher than its joint's: {which}. {remedy}"]
    text = (
        f"without feedback nothing notices a servo that restarts. It then moves with its stored "
        f"limits, which are higher than its joint's: {which}. {remedy}"
    )
    if is_forced:
        return [f"{text} (--force: played all the same)"], []
    if is_simulated:
        return [f"{text} (simulated: played all the same)"], []
    raise InputError(
        f"{text}. Or play with feedback; --force gives this protection up", path=robot.path
    )


# ---- the result


class ServoAnswers(Protocol):
    """What the servos answered: the present values, and the stored ones that were asked for."""

    answers: dict[tuple[str, int, str], int | str | None]
    stored: dict[tuple[str, int, str], int | str | None]


def check(
    program: Program,
    robot: Robot,
    joints: Sequence[Joint],
    asked: ServoAnswers,
    trackers: Mapping[str, QueryTracker],
    start_deg: Mapping[str, float],
    *,
    has_feedback: bool = True,
    is_forced: bool = False,
) -> list[Event]:
    """Return the warnings, and what was found at the servos, in answer to the queries.

    Raises as `check_sensors`, `check_answers` and `check_stored_limits` do. `start_deg`: where the
    show begins.
    """
    answers = asked.answers
    robot.require_turns(joints)
    echoes = check_echo(robot, answers, trackers)
    check_sensors(program, robot, answers)
    warnings = [
        *check_answers(joints, answers, robot, stored=asked.stored, show=program.on_fault),
        *check_range(joints, answers),
        *check_latency(robot.buses, trackers),
        *echoes,
    ]
    more, notes = check_stored_limits(
        joints, asked.stored, robot, has_feedback=has_feedback, is_forced=is_forced
    )
    rows = found(joints, answers, start_deg)
    return [*map(Warned, [*warnings, *more]), Checked(tuple(rows), tuple(notes))]


def check_echo(robot: Robot, answers: Answers, trackers: Mapping[str, QueryTracker]) -> list[str]:
    """Return a warning for each port that echoes; raise `BusError` if one does nothing else."""
    filters = {name: tracker.line.echo for name, tracker in trackers.items()}
    return judge_echo(robot.buses, filters, {bus for bus, _, _ in answers})


def check_answers(
    joints: Iterable[Joint],
    answers: Answers,
    robot: Robot,
    *,
    stored: Answers | None = None,
    show: Escalations | None = None,
    needs_frame: bool = True,
) -> list[str]:
    """Return warnings about the servos.

    Raises before anything moves: `BusError` for servos that do not answer, `InputError` where the
    robot file contradicts the servo or exceeds its limits, `PlaybackError` for one in a state in
    which it may not be driven. Without `needs_frame` another gyre or origin is a warning.
    """
    joints = list(joints)
    standing = standing_deg(joints, answers)
    if silent := [joint for joint in joints if joint.name not in standing]:
        raise silent_error(silent, joints, robot, answers)
    reasons = refusals(joints, answers, stored or {}, robot, show)
    soft = [one for one in reasons if one.is_warning or (one.is_frame and not needs_frame)]
    if hard := [reason for reason in reasons if reason not in soft]:
        raise combined(hard)
    warnings = [str(reason.error) for reason in soft]
    for joint in joints:
        warnings += _warnings(joint, answers)
    return warnings


def _warnings(joint: Joint, answers: Answers) -> Iterator[str]:
    """Yield what a person should know of a servo that may be driven."""
    status = status_of(joint, answers)
    if status is Status.OUTSIDE_LIMITS:
        yield (
            f"joint {joint.name!r}: servo {joint.servo_id} is outside of its own limits (CLN, "
            f"CLP): it will not go everywhere that the robot file allows"
        )
    unknown = [
        name
        for name in expected_frame(joint)
        if name != "AR"
        and not isinstance(answers.get((joint.bus, joint.servo_id, f"Q{name}")), int)
    ]
    if unknown:
        yield (
            f"joint {joint.name!r}: servo {joint.servo_id} does not report its "
            f"{' and '.join(unknown)}, so they were not compared with the robot file"
        )


def check_range(joints: Iterable[Joint], answers: Answers) -> list[str]:
    """Return a warning for every joint outside of its range: the approach moves it back.

    Raises `PlaybackError` for one that is half a turn or more outside: it is in another turn, or
    its angles are in another unit, and the way back would be as wrong. An RC servo on a 2IO does
    not report where it stands.
    """
    warnings = []
    for joint in joints:
        servo_deg = reported(joint, answers, "QD")
        if servo_deg is None or joint.drive == "stepped":
            continue
        angle_deg, least_deg, most_deg = (
            joint.joint_deg(servo_deg),
            joint.position_min_deg,
            joint.position_max_deg,
        )
        if max(least_deg - angle_deg, angle_deg - most_deg) >= HALF_TURN_DEG:
            raise PlaybackError(
                f"joint {joint.name!r}: servo {joint.servo_id} reports {servo_deg:.1f} deg, so the "
                f"joint would stand at {angle_deg:.1f} deg, half a turn or more outside of its "
                f"range of {least_deg:g} to {most_deg:g} deg. It is in another turn, or its angles "
                f"are in another unit. Hold the robot, switch the servo's power off and on, and "
                f"check its `model` and `zero_deg`. Nothing is driven back that far",
                joint=joint.name,
            )
        if not least_deg - OUTSIDE_DEG <= angle_deg <= most_deg + OUTSIDE_DEG:
            warnings.append(
                f"joint {joint.name!r} stands at {angle_deg:.1f} deg, outside of its range of "
                f"{least_deg:g} to {most_deg:g} deg, and is led back into it. See that its way is "
                f"free, and that `zero_deg` and `direction` are right (lss-motion calibrate)"
            )
    return warnings


def check_sensors(program: Program, robot: Robot, answers: Answers) -> None:
    """Raise `BusError` for a sensor that the show waits for and that does not answer."""
    for sensor in _sensors(program, robot):
        if not isinstance(answers.get((sensor.bus, sensor.servo_id, "QA")), int):
            raise BusError(
                f"no answer from sensor {sensor.name!r} (id {sensor.servo_id} on bus "
                f"{sensor.bus!r}), which the show waits for",
                url=robot.buses[sensor.bus].port,
            )


def _sensors(program: Program, robot: Robot) -> list[Sensor]:
    return [robot.sensors[name] for name in {p.wait.sensor: None for p in program.waits}]


def reported_firmware(joint: Joint, answers: Answers) -> int | None:
    """Return the firmware that a servo reported; None: it did not."""
    firmware = answers.get((joint.bus, joint.servo_id, "QF"))
    return firmware if isinstance(firmware, int) else None


def status_of(joint: Joint, answers: Answers) -> Status | None:
    """Return the status that a servo reported; None: it did not.

    The numbers depend on its firmware: on what it reported, never on what the robot file has.
    """
    code = answers.get((joint.bus, joint.servo_id, "Q"))
    if not isinstance(code, int):
        return None
    return status_from(code, joint.model.family, reported_firmware(joint, answers))


def check_latency(buses: Mapping[str, Bus], trackers: Mapping[str, QueryTracker]) -> list[str]:
    """Return a warning for every port on which all answers came later than servos answer."""
    warnings = []
    for name, tracker in trackers.items():
        least_ns, port = tracker.shortest_latency_ns, buses[name].port
        if least_ns is None or least_ns < LATENCY_BAD_NS:
            continue
        device = port.rpartition("/")[2] or "ttyUSB0"  # A simulated port has no name.
        warnings.append(
            f"port {port}: answers come {least_ns / NS_PER_MS:.0f} ms late, so there are fewer "
            f"readings: the USB adapter holds them back. Linux: `echo 1 | sudo tee "
            f"/sys/bus/usb-serial/devices/{device}/latency_timer`; Windows: device manager, port, "
            f"advanced, latency timer 1 ms"
        )
    return warnings


def found(
    joints: Iterable[Joint], answers: Answers, start_deg: Mapping[str, float]
) -> list[CheckedServo]:
    """Return what is known of every servo, for people to check before anything moves."""
    rows = []
    for joint in joints:
        model = answers.get((joint.bus, joint.servo_id, "QMS"))
        firmware = answers.get((joint.bus, joint.servo_id, "QF"))
        values = {key: reported(joint, answers, key) for key in ("QD", "QV", "QT", "QSD", "QAA")}
        assert values["QD"] is not None, "checked before"
        status = status_of(joint, answers)
        rows.append(
            CheckedServo(
                joint=joint.name,
                servo_id=joint.servo_id,
                model=None if model is None else str(model),
                firmware=firmware if isinstance(firmware, int) else None,
                status=None if status is None else status.value,
                position_deg=joint.joint_deg(values["QD"]),
                start_deg=start_deg[joint.name],
                voltage_v=values["QV"],
                temperature_c=values["QT"],
                speed_max_deg_s=values["QSD"],
                accel_max_deg_s2=values["QAA"],
            )
        )
    return rows
