"""Checks, settings, restore and recovery: what surrounds the motion of a show.

Before the show, every servo is queried (`queries`), and `check` compares the answers with the robot
file and the program. `SettingsDialogue` then sends the session settings until every servo answers
with what it was sent: a timed servo gets the joint's own limits (AA, AD and SD), which it keeps
whatever it receives, and EM1, in which `D…T…` works; a streamed one gets EM0 with the program's
FPC. An RC servo on a 2IO has no settings. `Recovery` waits for servos that are missing. Afterwards
`restoring_orders` gives back the original settings, and `safe_bytes` are the last bytes.

Answers are keyed by `(bus, servo id, keyword)`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.player.cues import LED_KEYWORD
from lss_motion.player.events import Checked, Found, Warned
from lss_motion.player.transactions import Dialogue, Item
from lss_motion.program.model import ramp_setting_deg_s2
from lss_motion.protocol.codec import FAMILY_TABLES, make_command, read_reply
from lss_motion.protocol.constants import BROADCAST_ID, Status, status_from
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.robot.servo_models import FILTER_FIRMWARE_MIN, model_mismatch_text
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from lss_motion.player.events import Event
    from lss_motion.player.query_tracker import QueryTracker
    from lss_motion.player.serial_line import SerialLine
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Bus, Joint, Robot, Sensor

    Answers = Mapping[tuple[str, int, str], int | str | None]


UNCONFIRMED_TRIES: Final = 2
"""Tries per round for a query that a servo has not answered before."""
SETTING_TRIES: Final = 4
"""Rounds in which a setting is sent until the servo answers with it. Chosen: on a line that loses
every tenth command, one of 10,000 settings stays wrong."""


class SettingsDialogue:
    """A `Dialogue` that sends orders until every servo answers with what it was sent.

    `wrong` are the orders that were not applied in `SETTING_TRIES` rounds. Those of `unconfirmed`
    may also stay unanswered, since the servo may not support them. `then` are queries that follow
    the orders in every round.
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
    """Return the queries that show whether orders were applied."""
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
    """Return the orders whose values the answers to `read_back` do not confirm."""
    return [
        order
        for order in orders
        if answers.get((order.bus, order.command.servo_id, f"Q{order.command.keyword}"))
        != order.command.value
    ]


def is_answered(order: Item, answers: Answers) -> bool:
    """Return whether the servo answered the read-back of an order."""
    return (order.bus, order.command.servo_id, f"Q{order.command.keyword}") in answers


def not_applied_error(order: Item, answers: Answers, joints: Iterable[Joint]) -> PlaybackError:
    """Return the error for an order that was not applied in `SETTING_TRIES` rounds."""
    command = order.command
    name = next(j.name for j in joints if (j.bus, j.servo_id) == (order.bus, command.servo_id))
    answer = answers.get((order.bus, command.servo_id, f"Q{command.keyword}"))
    return PlaybackError(
        f"joint {name!r}: servo {command.servo_id} was set to {command.keyword} {command.value} "
        f"{SETTING_TRIES} times and answers {'nothing' if answer is None else answer}. Check "
        f"wiring and power; nothing is driven without its limits",
        joint=name,
    )


RESTORING_TIMES: Final = 2
"""Settings are given back this often, without read-back: a stop must not take longer."""
SESSION_KEYWORDS: Final = ("EM", "AA", "AD", "SD", "FPC", "IPE")
LIMIT_KEYWORDS: Final = ("EM", "AA", "AD", "SD")
"""Without these a servo does not keep the joint's limits, or accepts no limits at all."""


def reported(joint: Joint, answers: Answers, keyword: str) -> float | None:
    """Return the value that a servo reported for `keyword`, in physical units; None: no number."""
    value = answers.get((joint.bus, joint.servo_id, keyword))
    if not isinstance(value, int):
        return None
    answer = read_reply(joint.model.family, Reply(joint.servo_id, keyword, value))
    return (
        float(answer.value)
        if answer is not None and isinstance(answer.value, int | float)
        else None
    )


def session_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the settings for the show whose original value is known; see `unconfirmed_orders`."""
    orders = []
    for joint in joints:
        orders += _session_orders(joint, answers, is_known=True)
        orders += [
            _order(joint, Command(joint.servo_id, keyword, value))
            for keyword, value in joint.settings.items()
        ]
    return orders


def unconfirmed_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the limits for the show whose original value is unknown.

    The line was bad, or the servo does not support the query (no document says which family answers
    all). The limits are sent all the same, since limits must hold. They cannot be given back: the
    servo keeps them until it restarts.
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
    """Return the keywords that a show sets besides those of the drive.

    `led_joints` are the joints whose LED colours it changes.
    """
    lights = [LED_KEYWORD] if joint.name in led_joints and LED_KEYWORD not in joint.settings else []
    return [*joint.settings, *lights]


def _session_of(joint: Joint) -> dict[str, float]:
    """Return the session settings that the drive of a joint needs, in physical units.

    FPC comes before EM0, so that the filter is right from its first step on. It is unknown whether
    SD limits anything in EM0; it does no harm.
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
    """Return the orders that give back all settings, and the LED colours of `led_joints`.

    All of them are repeated `RESTORING_TIMES`.
    """
    return [
        _order(joint, Command(joint.servo_id, keyword, original))
        for _ in range(RESTORING_TIMES)
        for joint in joints
        for keyword in (*SESSION_KEYWORDS, *changed(joint, led_joints))
        if isinstance(original := answers.get((joint.bus, joint.servo_id, f"Q{keyword}")), int)
    ]


def _order(joint: Joint, command: Command) -> Item:
    return Item(bus=joint.bus, command=command, is_query=False)


QUERIES: Final = ("QMS", "QF", "Q", "QSD", "QAA", "QAD", "QEM", "QV", "QT", "QD")
"""Queries to every servo before anything moves. Without an answer to QD the show does not start. A
servo that answers QMS and QD but not the others is driven: no document says which family answers
all. A servo that does not answer the first query counts as silent (`transactions.TRIES`), so that
is QMS, which all three documents have."""
PLACE_WITHIN_DEG: Final = 2.0
"""Two positions agree within this: noise, and an arm that sags when a hand releases it."""
AGREE_WITHIN: Final = {"QV": 500, "QT": 20}
"""Largest change of voltage (mV) and temperature (tenths of a degree) within two milliseconds."""
ARRIVED_DEG: Final = 3.0
"""A joint further from its start than this is sent there again; less may be its load."""
LOADED_DEG: Final = 1.0
"""With feedback the load is known after the first approach. A joint that its load keeps further
away than this is sent there once more, corrected: that takes half a second, and the show then
begins at the right place."""
OUTSIDE_DEG: Final = 1.0
"""No warning for less outside of the range: a load may have pulled the joint there. Chosen."""
LATENCY_BAD_NS: Final = 5 * NS_PER_MS
"""A servo answers within 2 ms (FACTS.md W14); an adapter's latency timer makes it longer."""
FILTER_QUERIES: Final = ("QFPC", "QIPE")
"""Further queries to streamed servos. IPE makes the filter step by itself (FACTS.md M8); a servo
that does not answer QIPE is assumed to have the factory setting, which does so."""
FILTER_ESSENTIAL: Final = ("QD", "QEM", "QFPC")
IO2_QUERIES: Final = ("QMS", "QG", "QD")
"""An RC servo on a 2IO answers no more, and QD is only its last command (FACTS.md B8, B10)."""
LIMIT_SLACK_RATIO: Final = 0.999
"""Limits read back from a servo are rounded to its wire unit."""


def queries(joints: Iterable[Joint], led_joints: Container[str] = ()) -> list[Item]:
    """Return the queries before a show that changes the LED colours of `led_joints`.

    Queries that only some servos support come last.
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
    """Return the queries for what `settings` of the robot file, and LED colours, will overwrite."""
    return [_query(joint, f"Q{word}") for joint in joints for word in changed(joint, led_joints)]


def position_queries(joints: Iterable[Joint]) -> list[Item]:
    """Return the position query of every servo."""
    return [_query(joint, "QD") for joint in joints]


def _query(joint: Joint, keyword: str) -> Item:
    within = AGREE_WITHIN.get(keyword, 0)
    if keyword == "QD":
        within = round(PLACE_WITHIN_DEG * joint.model.wire_per_deg)
    command = Command(joint.servo_id, keyword)
    return Item(bus=joint.bus, command=command, is_query=True, agree_within=within)


def check(
    program: Program,
    robot: Robot,
    joints: Sequence[Joint],
    answers: Answers,
    trackers: Mapping[str, QueryTracker],
    start_deg: Mapping[str, float],
) -> list[Event]:
    """Return the warnings, and what was found at the servos, in answer to the queries.

    Raises as `check_sensors` and `check_answers` do. `start_deg`: where the show begins.
    """
    check_sensors(program, robot, answers)
    warnings = findings(joints, answers, robot, trackers)
    rows = found(joints, answers, robot, start_deg)
    return [*map(Warned, warnings), Checked(tuple(rows))]


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
    """Return a warning for every joint outside of its range: the approach moves it back.

    An RC servo on a 2IO does not report where it stands.
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
    """Return a query to every sensor that the show waits for."""
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
    """Return warnings about the servos.

    Raises before anything moves: `BusError` for servos that do not answer, `InputError` where the
    robot file contradicts the servo or exceeds its limits, `PlaybackError` for one in safe mode.
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
    """Raise for a servo that cannot be driven as the program requires."""
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
    """Return the servo angle of every joint that reported its position."""
    angles = {joint.name: reported(joint, answers, "QD") for joint in joints}
    return {name: angle for name, angle in angles.items() if angle is not None}


def silent_error(silent: Sequence[Joint], joints: Sequence[Joint], robot: Robot) -> BusError:
    """Return the error for servos that do not answer."""
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
            f"joint {joint.name!r}: {model_mismatch_text(joint, str(model))}",
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
                f"joint {joint.name!r}: the robot file requires {needed:g} {unit}, but servo "
                f"{joint.servo_id} is set to {allowed:g} {unit} ({keyword[1:]}). Lower the limit "
                f"in the robot file, or configure the servo",
                path=robot.path,
                line=joint.lines.get("speed_max_deg_s" if is_speed else "accel_max_deg_s2"),
            )


def _status(joint: Joint, answers: Answers, robot: Robot) -> Status | None:
    """Return the status that a servo reported; None: it did not."""
    code = answers.get((joint.bus, joint.servo_id, "Q"))
    if not isinstance(code, int):
        return None
    return status_from(code, joint.model.family, robot.buses[joint.bus].firmware)


def check_latency(buses: Mapping[str, Bus], trackers: Mapping[str, QueryTracker]) -> list[str]:
    """Return a warning for every port on which all answers came later than servos answer."""
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
    """Return what is known of every servo, for people to check before anything moves."""
    rows = []
    for joint in joints:
        model = answers.get((joint.bus, joint.servo_id, "QMS"))
        firmware = answers.get((joint.bus, joint.servo_id, "QF"))
        values = {key: reported(joint, answers, key) for key in ("QD", "QV", "QT", "QSD", "QAA")}
        assert values["QD"] is not None, "checked before"
        status = _status(joint, answers, robot)
        rows.append(
            Found(
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


def safe_bytes(
    robot: Robot, *, is_limp: bool = False, limp: Iterable[Joint] = ()
) -> dict[str, bytes]:
    """Return, per bus, the last bytes of every run: hold where it is, or go limp (FACTS.md A24).

    The motors of `limp` lose their power in any case.
    """
    last = dict.fromkeys(robot.buses, encode(Command(BROADCAST_ID, "L" if is_limp else "H")))
    for joint in limp:
        last[joint.bus] += limp_bytes(joint)
    return last


def limp_bytes(joint: Joint) -> bytes:
    """Return the bytes that take the power from one motor."""
    return encode(Command(joint.servo_id, "L"))


UNLIMITED_TRIES: Final = 1_000_000
"""A recovery ends by its time, not by a number of tries."""


def restart_probes(joints: Iterable[Joint], original: Answers) -> list[Item]:
    """Return for each servo one setting that a restart would change back, if there is one.

    A restart loses all that the session changed, and changes nothing else. So one is enough.
    """
    telling: dict[tuple[str, int], Item] = {}
    for order in changing_orders(joints, original):
        telling.setdefault((order.bus, order.command.servo_id), order)
    return list(telling.values())


def changing_orders(joints: Iterable[Joint], original: Answers) -> list[Item]:
    """Return the settings for the show that differ from the original ones."""
    return not_applied(session_orders(joints, original), original)


@dataclass(slots=True)
class Recovery:
    """One wait: the player brakes and polls until all of `missing` answer, or gives up."""

    give_up_ns: int
    missing: list[Joint] = field(default_factory=list)

    def add(self, joints: list[Joint], give_up_ns: int) -> None:
        """Wait for these, too, and for all until `give_up_ns`."""
        self.give_up_ns = give_up_ns
        self.missing += [joint for joint in joints if joint not in self.missing]

    def replace_missing(self, joints: Iterable[Joint]) -> None:
        """Wait for these only."""
        self.missing = list(joints)

    def queries(self, original: Answers) -> list[Item]:
        """Return the queries for their positions, and for the settings that they were sent."""
        orders = session_orders(self.missing, original)
        items = [*read_back(orders), *position_queries(self.missing)]
        return [replace(item, tries=UNLIMITED_TRIES) for item in items]

    def absent(self, answers: Answers) -> list[Joint]:
        """Return the joints that have not reported their position."""
        present = standing_deg(self.missing, answers)
        return [joint for joint in self.missing if joint.name not in present]

    def restarted(self, answers: Answers, original: Answers) -> list[Joint]:
        """Return the joints that have lost the settings that they were sent."""
        return [
            joint
            for joint in self.missing
            if not_applied(session_orders([joint], original), answers)
        ]
