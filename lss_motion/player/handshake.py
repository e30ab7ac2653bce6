"""What happens before and after the show: checks, settings, restore and recovery.

Before and after a show: which servos are there, may they do what the plan asks, what is safe.

Gives servos their settings, and makes sure of it: said, asked back, said again.

The settings of a show: what each servo gets for its drive, and gets back afterwards.

For the time of the show, every timed servo gets the joint's own limits (AA, AD and SD), so that it
keeps them whatever it hears, and EM1, in which `D…T…` works; a streamed one gets EM0 with the
program's FPC; afterwards each gets back what it had. An RC servo on a 2IO has no settings.

Who is gone, how long they are waited for, and what to ask them when they are back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.player.cues import LED_KEYWORD
from lss_motion.player.events import Found
from lss_motion.player.transactions import Dialogue, Item
from lss_motion.program.model import ramp_setting_deg_s2
from lss_motion.protocol.codec import make_command, read_reply
from lss_motion.protocol.constants import BROADCAST_ID, Status, status_from
from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.robot.servo_models import FILTER_FIRMWARE_MIN, other_model
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from lss_motion.player.query_tracker import QueryTracker
    from lss_motion.player.serial_line import SerialLine
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Bus, Joint, Robot, Sensor

    Answers = Mapping[tuple[str, int, str], int | str | None]


UNCONFIRMED_TRIES: Final = 2
"""How often a servo is asked, in a round, for what it has not answered before."""
SETTING_TRIES: Final = 4
"""How often a setting is sent that the servo does not answer with. Chosen: on a line that loses
every tenth command, one of 10,000 settings stays wrong."""


class SettingsDialogue:
    """A `Dialogue` that sends orders until every servo answers with what it was told.

    `wrong` are the orders that were not taken in `SETTING_TRIES` rounds. Those of `unsure` may
    also stay unanswered: nobody knows whether the servo knows them. `then` is asked in every
    round, after the orders.
    """

    def __init__(
        self,
        orders: Sequence[Item],
        then: Iterable[Item],
        unconfirmed: Sequence[Item],
        lines: Mapping[str, SerialLine],
        trackers: Mapping[str, QueryTracker],
    ) -> None:
        self.wrong = list(orders)
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._then = list(then)
        self._unconfirmed = list(unconfirmed)
        self._lines = lines
        self._trackers = trackers
        self._rounds = 0
        self._dialogue = self._round()

    @property
    def is_finished(self) -> bool:
        return self._dialogue.is_finished and not self._must_repeat()

    def advance(self, now_ns: int) -> None:
        self._dialogue.advance(now_ns)
        if not self._dialogue.is_finished:
            return
        self.answers.update(self._dialogue.answers)
        self.wrong = not_applied(self.wrong, self.answers)
        self._unconfirmed = not_applied(self._unconfirmed, self.answers)
        if self._must_repeat():
            self._dialogue = self._round()
            self._dialogue.advance(now_ns)
        else:
            self.wrong += [order for order in self._unconfirmed if is_answered(order, self.answers)]
            self._unconfirmed = []

    def _must_repeat(self) -> bool:
        return bool(self.wrong or self._unconfirmed) and self._rounds < SETTING_TRIES

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return self._dialogue.next_wakeup_ns()

    def _round(self) -> Dialogue:
        self._rounds += 1
        unconfirmed = [
            replace(item, tries=UNCONFIRMED_TRIES) for item in read_back(self._unconfirmed)
        ]
        items = [*self.wrong, *self._unconfirmed, *read_back(self.wrong), *unconfirmed, *self._then]
        return Dialogue(items, self._lines, self._trackers)


def read_back(orders: Iterable[Item]) -> list[Item]:
    """Return what to ask to know whether orders were taken."""
    return [
        Item(
            bus=order.bus,
            command=Command(order.command.servo_id, f"Q{order.command.keyword}"),
            is_query=True,
            agree_within=0,
        )
        for order in orders
    ]


def not_applied(orders: Iterable[Item], answers: Answers) -> list[Item]:
    """Return the orders that the servos, asked by `read_back`, do not answer with."""
    return [
        order
        for order in orders
        if answers.get((order.bus, order.command.servo_id, f"Q{order.command.keyword}"))
        != order.command.value
    ]


def is_answered(order: Item, answers: Answers) -> bool:
    """Return whether the servo said what it has of what it was told."""
    return (order.bus, order.command.servo_id, f"Q{order.command.keyword}") in answers


def not_applied_error(order: Item, answers: Answers, joints: Iterable[Joint]) -> PlaybackError:
    """Return what to say about an order that was not taken in `SETTING_TRIES` tries."""
    command = order.command
    name = next(j.name for j in joints if (j.bus, j.servo_id) == (order.bus, command.servo_id))
    said = answers.get((order.bus, command.servo_id, f"Q{command.keyword}"))
    return PlaybackError(
        f"joint {name!r}: servo {command.servo_id} was set to {command.keyword} {command.value} "
        f"{SETTING_TRIES} times and answers {'nothing' if said is None else said}. Check wiring "
        f"and power; nothing is driven without its limits",
        joint=name,
    )


RESTORING_TIMES: Final = 2
"""Settings are given back so often, unasked: a stop must not take longer than this."""
SESSION_KEYWORDS: Final = ("EM", "AA", "AD", "SD", "FPC", "IPE")
LIMIT_KEYWORDS: Final = ("EM", "AA", "AD", "SD")
"""Without these a servo does not keep the joint's limits, or takes no limits at all."""


def reported(joint: Joint, answers: Answers, keyword: str) -> float | None:
    """Return the number that a servo answered to `keyword`, in physical units, if it did."""
    value = answers.get((joint.bus, joint.servo_id, keyword))
    if not isinstance(value, int):
        return None
    said = read_reply(joint.model.family, Reply(joint.servo_id, keyword, value))
    return float(said.value) if said is not None and isinstance(said.value, int | float) else None


def session_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the settings for the show that servos said what they had of; for others `unsure`."""
    orders = []
    for joint in joints:
        orders += _session_orders(joint, answers, is_known=True)
        orders += [
            _order(joint, Command(joint.servo_id, keyword, value))
            for keyword, value in joint.settings.items()
        ]
    return orders


def unconfirmed_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the limits for the show that servos did not say what they had of.

    The line was bad, or the servo does not know them (no document says which family answers all):
    it is told them all the same, for limits hold. What it had nobody knows: it keeps them until
    it restarts.
    """
    return [
        order
        for joint in joints
        for order in _session_orders(joint, answers, is_known=False)
        if order.command.keyword in LIMIT_KEYWORDS
    ]


def _session_orders(joint: Joint, answers: Answers, *, is_known: bool) -> list[Item]:
    known = FAMILY_TABLES[joint.model.family].by_keyword
    return [
        _order(joint, make_command(joint.model.family, joint.servo_id, keyword, value))
        for keyword, value in _session_of(joint).items()
        if f"Q{keyword}" in known
        and is_known is (reported(joint, answers, f"Q{keyword}") is not None)
    ]


def changed(joint: Joint, led_joints: Container[str]) -> list[str]:
    """Return what a show that changes the colours of the joints `lit` sets besides the drive."""
    lights = [LED_KEYWORD] if joint.name in led_joints and LED_KEYWORD not in joint.settings else []
    return [*joint.settings, *lights]


def _session_of(joint: Joint) -> dict[str, float]:
    """Return the session settings that the drive of a joint needs, in physical units.

    FPC comes before EM0, so that the filter is what it should be from its first step on. Whether
    SD bounds anything in EM0 is not known; it does no harm.
    """
    if joint.drive == "stepped":
        return {}
    if joint.drive == "streamed":
        count = float(joint.filter_count)
        return {"FPC": count, "IPE": 1.0, "SD": joint.speed_max_deg_s, "EM": 0.0}
    ramp = float(ramp_setting_deg_s2(joint))
    return {"EM": 1.0, "AA": ramp, "AD": ramp, "SD": joint.speed_max_deg_s}


def restoring_orders(
    joints: Iterable[Joint], answers: Answers, led_joints: Container[str] = ()
) -> list[Item]:
    """Return what gives every servo back its settings, and to those `lit` their colours.

    All of it is said `RESTORING_TIMES`.
    """
    return [
        _order(joint, Command(joint.servo_id, keyword, had))
        for _ in range(RESTORING_TIMES)
        for joint in joints
        for keyword in (*SESSION_KEYWORDS, *changed(joint, led_joints))
        if isinstance(had := answers.get((joint.bus, joint.servo_id, f"Q{keyword}")), int)
    ]


def _order(joint: Joint, command: Command) -> Item:
    return Item(bus=joint.bus, command=command, is_query=False)


QUERIES: Final = ("QMS", "QF", "Q", "QSD", "QAA", "QAD", "QEM", "QV", "QT", "QD")
"""Asked of every servo before anything moves. Without QD the show does not start. One that answers
QMS and QD but not the others is driven: no document says which family answers all. By its first
question a servo counts as silent (`dialogue.TRIES`), so that is QMS, which all three documents
have."""
PLACE_WITHIN_DEG: Final = 2.0
"""Two positions that agree: noise, and a hand that lets go of an arm."""
AGREE_WITHIN: Final = {"QV": 500, "QT": 20}
"""What voltage (mV) and temperature (tenths of a degree) may change by in two milliseconds."""
ARRIVED_DEG: Final = 3.0
"""A joint further from its start than this is sent there again; nearer, it may be its load."""
LOADED_DEG: Final = 1.0
"""With feedback a load is known after the first approach. A joint that it keeps further away than
this is sent there once more, corrected: half a second, and the show begins where it should."""
OUTSIDE_DEG: Final = 1.0
"""A joint may stand so far outside of its range unsaid: a load may have pulled it there. Chosen."""
LATENCY_BAD_NS: Final = 5 * NS_PER_MS
"""A servo answers within 2 ms (FACTS.md W14); what takes longer is an adapter's latency timer."""
FILTER_QUERIES: Final = ("QFPC", "QIPE")
"""Asked of streamed servos as well. IPE makes the filter step by itself (FACTS.md M8); a servo
that does not answer QIPE is taken to do so, as from the factory."""
FILTER_ESSENTIAL: Final = ("QD", "QEM", "QFPC")
IO2_QUERIES: Final = ("QMS", "QG", "QD")
"""An RC servo on a 2IO knows no more, and QD is only its last command (FACTS.md B8, B10)."""
LIMIT_SLACK_RATIO: Final = 0.999
"""Limits read back from a servo are rounded to its wire unit."""


def queries(joints: Iterable[Joint], led_joints: Container[str] = ()) -> list[Item]:
    """Return what to ask before a show that changes the colours of the joints `lit`.

    What only some servos know comes last.
    """
    joints = list(joints)
    known = [
        _query(joint, keyword)
        for joint in joints
        for keyword in _asked_of(joint)
        if keyword in FAMILY_TABLES[joint.model.family].by_keyword
    ]
    return known + settings_queries(joints, led_joints)


def _asked_of(joint: Joint) -> tuple[str, ...]:
    match joint.drive:
        case "stepped":
            return IO2_QUERIES
        case "streamed":
            return (*QUERIES, *FILTER_QUERIES)
        case _:
            return QUERIES


def settings_queries(joints: Iterable[Joint], led_joints: Container[str] = ()) -> list[Item]:
    """Return what to ask so that the `settings` of the robot file, and colours, can be undone."""
    return [_query(joint, f"Q{word}") for joint in joints for word in changed(joint, led_joints)]


def position_queries(joints: Iterable[Joint]) -> list[Item]:
    """Return what to ask to know where every servo is."""
    return [_query(joint, "QD") for joint in joints]


def _query(joint: Joint, keyword: str) -> Item:
    within = AGREE_WITHIN.get(keyword, 0)
    if keyword == "QD":
        within = round(PLACE_WITHIN_DEG * joint.model.wire_per_deg)
    command = Command(joint.servo_id, keyword)
    return Item(bus=joint.bus, command=command, is_query=True, agree_within=within)


def findings(
    joints: Iterable[Joint],
    answers: Answers,
    robot: Robot,
    trackers: Mapping[str, QueryTracker],
) -> list[str]:
    """Return all warnings about servos and ports; raise as `check_answers` does."""
    joints = list(joints)
    return (
        check_answers(joints, answers, robot)
        + check_range(joints, answers)
        + check_latency(robot.buses, trackers)
    )


def check_range(joints: Iterable[Joint], answers: Answers) -> list[str]:
    """Return a warning for every joint that stands where it may not: it will be led back.

    An RC servo on a 2IO does not say where it stands.
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
        if not least_deg - OUTSIDE_DEG <= angle_deg <= most_deg + OUTSIDE_DEG:
            warnings.append(
                f"joint {joint.name!r} stands at {angle_deg:.1f} deg, outside of its range of "
                f"{least_deg:g} to {most_deg:g} deg, and is led back into it. See that its way is "
                f"free, and that `zero_deg` and `direction` are right (lss-motion calibrate)"
            )
    return warnings


def sensor_queries(program: Program, robot: Robot) -> list[Item]:
    """Return what to ask the sensors that a show waits for: whether they are there."""
    return [
        Item(bus=sensor.bus, command=Command(sensor.servo_id, "QA"), is_query=True)
        for sensor in _sensors(program, robot)
    ]


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


def check_answers(joints: Iterable[Joint], answers: Answers, robot: Robot) -> list[str]:
    """Return warnings about the servos found.

    Raises before anything moves: `BusError` for servos that do not answer, `InputError` where the
    robot file claims what the servo is not or may not do, `PlaybackError` for one in safe mode.
    """
    joints = list(joints)
    standing = standing_deg(joints, answers)
    if silent := [joint for joint in joints if joint.name not in standing]:
        raise silent_error(silent, joints, robot)
    warnings: list[str] = []
    for joint in joints:
        _check_drive(joint, answers, robot)
        _check_joint(joint, answers, robot, warnings)
    return warnings


def _check_drive(joint: Joint, answers: Answers, robot: Robot) -> None:
    """Refuse a servo that cannot be driven as the program wants."""
    if joint.drive == "stepped" and reported(joint, answers, "QG") == -1.0:
        raise InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} has a gyre of -1, with which an LSS-2IO "
            f"says nonsense about where it is. Set its gyre to 1 (CG1), and `direction: -1` here",
            path=robot.path,
        )
    unknown = [key[1:] for key in FILTER_ESSENTIAL if reported(joint, answers, key) is None]
    if joint.drive == "streamed" and unknown:
        firmware = answers.get((joint.bus, joint.servo_id, "QF"))
        is_old = isinstance(firmware, int) and firmware < FILTER_FIRMWARE_MIN
        why = f"has firmware {firmware}" if is_old else f"does not say its {' and '.join(unknown)}"
        raise InputError(
            f"joint {joint.name!r}: servo {joint.servo_id} {why}, so it cannot be streamed and set "
            f"back. That needs an LSS with firmware {FILTER_FIRMWARE_MIN} or later; otherwise use "
            f"`drive: timed`",
            path=robot.path,
            line=joint.lines.get("drive"),
        )


def standing_deg(joints: Iterable[Joint], answers: Answers) -> dict[str, float]:
    """Return the servo angle of every joint that said where it is."""
    angles = {joint.name: reported(joint, answers, "QD") for joint in joints}
    return {name: angle for name, angle in angles.items() if angle is not None}


def silent_error(silent: Sequence[Joint], joints: Sequence[Joint], robot: Robot) -> BusError:
    """Return what to say about servos that do not answer."""
    named = ", ".join(f"{j.name} (id {j.servo_id} on bus {j.bus!r})" for j in silent)
    bus = robot.buses[silent[0].bus]
    return BusError(
        f"no answer from {len(silent)} of {len(joints)} servos: {named}. Check power, wiring, "
        f"ids and the baud rate ({bus.baud_bps} bps)",
        url=bus.port,
    )


def _check_joint(joint: Joint, answers: Answers, robot: Robot, warnings: list[str]) -> None:
    bus = robot.buses[joint.bus]
    model = answers.get((joint.bus, joint.servo_id, "QMS"))
    if model is not None and not str(model).startswith(joint.model.name):
        raise InputError(
            f"joint {joint.name!r}: {other_model(joint, str(model))}",
            path=robot.path,
            line=joint.lines.get("model"),
        )
    firmware = answers.get((joint.bus, joint.servo_id, "QF"))
    if isinstance(firmware, int) and firmware != bus.firmware:
        warnings.append(
            f"joint {joint.name!r}: servo {joint.servo_id} has firmware {firmware}, the robot "
            f"file says {bus.firmware}"
        )
    status = _status(joint, answers, robot)
    if status in (Status.SAFE_MODE, Status.ERROR):
        raise PlaybackError(
            f"joint {joint.name!r}: servo {joint.servo_id} reports {status.value}; find the "
            f"cause, then RESET it",
            joint=joint.name,
        )
    needs: dict[str, float] = {"QSD": joint.speed_max_deg_s}
    if joint.drive == "timed":
        needs |= dict.fromkeys(("QAA", "QAD"), ramp_setting_deg_s2(joint))
    for keyword, needed in needs.items():
        allowed = reported(joint, answers, keyword)
        if allowed is not None and allowed < LIMIT_SLACK_RATIO * needed:
            is_speed = keyword == "QSD"
            unit = "deg/s" if is_speed else "deg/s²"
            raise InputError(
                f"joint {joint.name!r}: the robot file asks for {needed:g} {unit}, but servo "
                f"{joint.servo_id} is set to {allowed:g} {unit} ({keyword[1:]}). Lower the limit "
                f"in the robot file, or configure the servo",
                path=robot.path,
                line=joint.lines.get("speed_max_deg_s" if is_speed else "accel_max_deg_s2"),
            )


def _status(joint: Joint, answers: Answers, robot: Robot) -> Status | None:
    """Return what a servo says that it is doing, if it said so."""
    code = answers.get((joint.bus, joint.servo_id, "Q"))
    if not isinstance(code, int):
        return None
    return status_from(code, joint.model.family, robot.buses[joint.bus].firmware)


def check_latency(buses: Mapping[str, Bus], trackers: Mapping[str, QueryTracker]) -> list[str]:
    """Return a warning for every port where each answer so far came later than servos answer."""
    warnings = []
    for name, tracker in trackers.items():
        least_ns, port = tracker.shortest_latency_ns, buses[name].port
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


def found(
    joints: Iterable[Joint], answers: Answers, robot: Robot, start_deg: Mapping[str, float]
) -> list[Found]:
    """Return what is known of every servo, for people to look at before anything moves."""
    rows = []
    for joint in joints:
        model = answers.get((joint.bus, joint.servo_id, "QMS"))
        firmware = answers.get((joint.bus, joint.servo_id, "QF"))
        said = {key: reported(joint, answers, key) for key in ("QD", "QV", "QT", "QSD", "QAA")}
        assert said["QD"] is not None, "checked before"
        status = _status(joint, answers, robot)
        rows.append(
            Found(
                joint=joint.name,
                servo_id=joint.servo_id,
                model=None if model is None else str(model),
                firmware=firmware if isinstance(firmware, int) else None,
                status=None if status is None else status.value,
                position_deg=joint.joint_deg(said["QD"]),
                start_deg=start_deg[joint.name],
                voltage_v=said["QV"],
                temperature_c=said["QT"],
                speed_max_deg_s=said["QSD"],
                accel_max_deg_s2=said["QAA"],
            )
        )
    return rows


def safe_bytes(
    robot: Robot, *, is_limp: bool = False, limp: Iterable[Joint] = ()
) -> dict[str, bytes]:
    """Return, per bus, the last bytes of every run: hold where it is, or go limp (FACTS.md A24).

    The joints of `limp` are let go, whatever the others do.
    """
    last = dict.fromkeys(robot.buses, encode(Command(BROADCAST_ID, "L" if is_limp else "H")))
    for joint in limp:
        last[joint.bus] += let_go(joint)
    return last


def let_go(joint: Joint) -> bytes:
    """Return the bytes that take the power from one motor."""
    return encode(Command(joint.servo_id, "L"))


UNLIMITED_TRIES: Final = 1_000_000
"""Until the time is over, whatever the number of tries."""


def restart_probes(joints: Iterable[Joint], had: Answers) -> list[Item]:
    """Return one setting of each servo that it no longer has if it restarts, if there is one.

    All that a session changes is lost together; what it did not change, a restart does not either.
    """
    telling: dict[tuple[str, int], Item] = {}
    for order in changing_orders(joints, had):
        telling.setdefault((order.bus, order.command.servo_id), order)
    return list(telling.values())


def changing_orders(joints: Iterable[Joint], had: Answers) -> list[Item]:
    """Return the settings for the show that servos had otherwise before."""
    return not_applied(session_orders(joints, had), had)


@dataclass(slots=True)
class Recovery:
    """One wait: the player brakes, asks until all of `missing` answer, or gives up."""

    give_up_ns: int
    missing: list[Joint] = field(default_factory=list)

    def add(self, joints: list[Joint]) -> None:
        self.missing += [joint for joint in joints if joint not in self.missing]

    def questions(self, had: Answers) -> list[Item]:
        """Return what to ask: where they are, and whether they still have what they were given."""
        orders = session_orders(self.missing, had)
        items = [*read_back(orders), *position_queries(self.missing)]
        return [replace(item, tries=UNLIMITED_TRIES) for item in items]

    def absent(self, answers: Answers) -> list[Joint]:
        """Return who has not said where it is."""
        present = standing_deg(self.missing, answers)
        return [joint for joint in self.missing if joint.name not in present]

    def restarted(self, answers: Answers, had: Answers) -> list[Joint]:
        """Return who has lost what it was given."""
        return [
            joint for joint in self.missing if not_applied(session_orders([joint], had), answers)
        ]
