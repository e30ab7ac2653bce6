"""One serial line with servos and boards on it, as a pure function of time.

`SimBus` has no clock, no thread and no port: its caller gives the instants. `bus_from_robot` makes
one bus of a robot file; `SimPort` is a bus as a port of the runner: `sim://`, in real or in virtual
time.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import BusError, LostPortError
from lss_motion.protocol.codec import storable, stored_wire
from lss_motion.protocol.constants import BROADCAST_ID, Family
from lss_motion.protocol.framing import commands_in
from lss_motion.sim.boards import RAW_MAX, SENSOR_FAR, Board, make_boards
from lss_motion.sim.faults import FOREVER_NS, RESTARTING, Drift, FaultKind, Faults, SecondMaster
from lss_motion.sim.horns import HornHistory
from lss_motion.sim.motors import Motors
from lss_motion.sim.odd_lines import OddLines
from lss_motion.sim.physics import TICK_NS, Physics, ServoSpec
from lss_motion.sim.servo import ORDERED_FIRMWARE, Servo
from lss_motion.sim.wire import Adapter, Answer, Answering, HostLine, ServoLine
from lss_motion.system.port import Outbox
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.faults import Fault, FaultEdge
    from lss_motion.sim.hand import HandMotion, Push
    from lss_motion.sim.servo import Lamp
    from lss_motion.system.clock import Clock

TWIN_DEG: Final = 20.0
"""How far from a servo its twin stands, so that the two report different angles. Chosen."""
ELSEWHERE: Final = frozenset({"B", "CRC", "FD", "FP"})
"""Settings of a robot file that a simulated servo does not have from the beginning."""


class SimBus:
    """Servos on a serial line. Its caller gives the time; the first instant is power-up.

    `write(data, now_ns)`     the host's bytes enter the line, queued behind earlier ones
    `read(now_ns)`            returns what has arrived at the host since the last `read`
    `next_arrival_ns()`       returns when the next reply is complete; None: none is under way
    `advance(now_ns)`         simulates up to now; `write` and `read` do so too

    Instants are the host's, and do not go back. The result does not depend on how often a method
    is called. With `usb_latency_ns` an adapter delivers the replies in packets.
    `inputs` are the ids of analog pins of LSS-2IO boards to which something is connected, with
    their values.
    """

    def __init__(
        self,
        servos: Sequence[ServoSpec],
        *,
        baud_bps: int,
        firmware: int,
        seed: int = 0,
        physics: Physics | None = None,
        faults: Sequence[Fault] = (),
        usb_latency_ns: int = 0,
        inputs: Mapping[int, int] | None = None,
    ) -> None:
        physics, own_count = physics or Physics(), len(servos)
        servos = [*servos, *_twins(servos, faults)]
        randoms = [Random(f"{seed}/{index}") for index in range(len(servos))]
        phases_ns = [random.randrange(TICK_NS) for random in randoms]
        self.baud_bps = baud_bps
        self.motors = Motors(servos, physics, phases_ns)
        self._set_up_ids = [spec.servo_id for spec in servos]
        self._set_up_gyre = np.array([spec.eeprom.get("G", 1) for spec in servos[:own_count]])
        self._set_up_origin_deg = np.array([_origin_deg(spec) for spec in servos[:own_count]])
        self.lines: list[tuple[int, bytes]] | None = None
        """After `record()`: every line that reached the servos, and when its CR did."""
        self.received: list[list[tuple[int, bytes]]] = [[] for _ in servos]
        """After `record()`: of these, the lines that each servo received, in the order of `servos`.
        A servo that is deaf receives none, and a line for other servos is left out."""
        self.restarts_ns: list[list[int]] = [[] for _ in servos]
        """When each servo lost its session: the instants of its `reset`, `factory`, `exchanged`."""
        self.stored_ns: list[list[tuple[int, Mapping[str, int]]]] = [[] for _ in servos]
        """When each servo got other settings: its `stored`, `factory` and `exchanged` faults, with
        wire values by name."""
        families = {spec.model.family for spec in servos}
        self._is_ordered = firmware >= ORDERED_FIRMWARE and families != {Family.LSS_PRO}
        self._adapter = Adapter(usb_latency_ns)
        self._host_line = HostLine(baud_bps)
        self.odd_lines = OddLines(physics.lines, is_grouped=self._is_ordered)
        self._servo_line = ServoLine(baud_bps, Random(f"{seed}/line"), self._adapter)
        self._faults = Faults(faults, Random(f"{seed}/faults"))
        self._answering = Answering(
            self._servo_line, self._faults, physics=physics, firmware=firmware, seed=seed
        )
        self._second_master = SecondMaster(faults)
        self._drift = Drift(fault for fault in faults if fault.kind is FaultKind.CLOCK_DRIFT)
        self._outages_ns: list[tuple[int, int]] = []
        self._blocks_ns: list[tuple[int, int]] = []
        self._is_started = False
        self._now_ns = 0
        """The last instant at which this bus was looked at, in the servos' time."""
        self.has_outages = False
        """Whether the port is unplugged at any time: it is looked at in each access to a port."""
        self._servos = [
            Servo(
                spec,
                index,
                self.motors,
                firmware=firmware if spec.firmware is None else spec.firmware,
                baud_bps=baud_bps,
                random=randoms[index],
            )
            for index, spec in enumerate(servos)
            if spec.model.family is not Family.IO2
        ]
        is_pro = (one for one in self._servos if one.family is Family.LSS_PRO)
        self._rc_servos: list[Servo] = []
        self._by_id: dict[int, list[Servo]] = {}
        self._usb_servo = next(is_pro, None)
        """The LSS-PRO at the end of the USB cable: the first one. The others are behind it."""
        if self._usb_servo is not None:
            self._usb_servo.connect_usb()
        self._boards = self._make_boards(servos, own_count, inputs or {}, seed)

    def _make_boards(
        self, servos: Sequence[ServoSpec], own_count: int, inputs: Mapping[int, int], seed: int
    ) -> list[Board]:
        """Return the boards of the RC servos and inputs.

        Twins, from `own_count` on, are on boards of their own: of the pins of one board with one id
        only the first answers.
        """
        outputs = [(n, spec) for n, spec in enumerate(servos) if spec.model.family is Family.IO2]
        own = [output for output in outputs if output[0] < own_count]
        twins = [output for output in outputs if output[0] >= own_count]
        random = Random(f"{seed}/boards")
        return [
            board
            for pins, values in ((own, inputs), (twins, {}))
            for board in make_boards(
                pins, values, self.motors, baud_bps=self.baud_bps, random=random
            )
        ]

    def record(self) -> None:
        """Keep `lines` and the true angles from now on; to be called before the first instant."""
        assert not self._is_started, "what happened before cannot be recorded"
        self.lines = []
        self.motors.history = HornHistory(self.servo_count)

    def write(self, data: bytes, now_ns: int) -> None:
        self._host_line.write(data, self._receive_until(now_ns))

    def read(self, now_ns: int) -> bytes:
        return self._servo_line.read(self._receive_until(now_ns))

    def next_arrival_ns(self) -> int | None:
        """Return when the earliest reply that was not read to its end is complete.

        With another host on the line it may also be when the next line of that host arrives.
        Bytes that the host has written reach the servos whatever it writes later, so this
        simulates ahead as far as the bytes on the line allow.
        """
        end_ns = self._servo_line.next_end_ns()
        lines, other_ns = self._host_line.lines, self._second_master.due_ns
        while lines and self._receive_next(FOREVER_NS if end_ns is None else end_ns - 1):
            end_ns, other_ns = self._servo_line.next_end_ns(), self._second_master.due_ns
        if other_ns < FOREVER_NS and (end_ns is None or other_ns < end_ns):
            end_ns = other_ns
        if end_ns is None:
            return None
        return self._drift.host_ns(end_ns) if self._drift.is_there else end_ns

    def advance(self, now_ns: int) -> None:
        self.motors.advance(self._receive_until(now_ns))

    @property
    def servo_count(self) -> int:
        return len(self.motors.gyre)

    @property
    def is_resting(self) -> bool:
        """Return whether no horn moves and no command is on the line."""
        self.motors.follow(self._now_ns)
        return self.motors.is_resting(self._now_ns) and not self._host_line.lines

    def set_host_rate(self, baud_bps: int, now_ns: int) -> None:
        """Set the rate of the host from now on. Only servos set to that rate receive its bytes."""
        self.advance(now_ns)
        self.baud_bps = baud_bps
        self._host_line.set_rate(baud_bps)
        self._servo_line.set_rate(baud_bps)

    def backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes of the host still occupy the line."""
        return self._host_line.backlog_ns(self._drift.bus_ns(now_ns))

    def outages_ns(self) -> list[tuple[int, int]]:
        """Return when the port is unplugged and back again; after the first instant.

        A restart of the LSS-PRO at the end of the USB cable adds an outage.
        """
        return [(self._drift.host_ns(a), self._drift.host_ns(b)) for a, b in self._outages_ns]

    def blocks_ns(self) -> list[tuple[int, int]]:
        """Return when the port takes no bytes of the host; after the first instant."""
        return [(self._drift.host_ns(a), self._drift.host_ns(b)) for a, b in self._blocks_ns]

    def horn_deg(self, times_ns: Iterable[int]) -> NDArray[np.float64]:
        """Return the true servo angles at given instants, (instants, servos), in the order given.

        They are angles of the gyre and origin with which each servo was set up, whatever its
        settings are meanwhile. Twins of servos are left out. Only after `record()`, and up to the
        instant of the last `advance`.
        """
        assert self.motors.history is not None, "call record() first"
        self.motors.advance(self._now_ns)
        raw_deg = self.motors.history.horn_deg(map(self._drift.bus_ns, times_ns))
        own_deg = raw_deg[:, : len(self._set_up_gyre)]
        return np.asarray(self._set_up_gyre * (own_deg - self._set_up_origin_deg))

    def set_pulse(self, servo_id: int, pulse_us: int | None, now_ns: int) -> None:
        """Send RC pulses of that width to a servo from now on; None: they end.

        Only a servo in RC mode (CRC1, CRC2) obeys them.
        """
        self.advance(now_ns)
        for servo in self._by_id.get(servo_id, ()):
            servo.take_pulse(pulse_us, self._drift.bus_ns(now_ns))

    def lamp(self, servo_id: int, now_ns: int) -> Lamp:
        """Return what the LED of the first servo with that id shows."""
        self.advance(now_ns)
        return self._by_id[servo_id][0].lamp(self._drift.bus_ns(now_ns))

    def set_input(self, servo_id: int, raw: int, now_ns: int) -> None:
        """Set the value of the analog inputs with an id to `raw` (0 to 1023) from now on.

        `boards.SENSORS` has the values for a distance.
        """
        assert 0 <= raw <= RAW_MAX, raw
        self.advance(now_ns)
        self._set_input(servo_id, raw)

    def _start(self, now_ns: int) -> None:
        self._is_started = True
        self._drift.start(now_ns)
        self.motors.start(now_ns)
        self._faults.start(now_ns)
        self._second_master.start(now_ns)
        self._outages_ns = self._faults.spans_ns(FaultKind.UNPLUGGED)
        self.has_outages = bool(self._outages_ns)
        self._blocks_ns = self._faults.spans_ns(FaultKind.BLOCKED_PORT)
        self._servo_line.start(self._faults.spans_ns(FaultKind.ECHO))
        self._adapter.start(now_ns, self._outages_ns)
        self._host_line.start(self._faults.spans_ns(FaultKind.CLOGGED), self._outages_ns)
        for servo in self._servos:
            servo.power_up(self._drift.bus_ns(now_ns))
        self._sort_servos()

    def _sort_servos(self) -> None:
        """Note which servos have which id, and which obey pulses: restarts and faults change it."""
        self._rc_servos = [servo for servo in self._servos if servo.is_in_rc_mode]
        self._by_id = {BROADCAST_ID: self._servos}
        for servo in self._servos:
            if servo.servo_id != BROADCAST_ID:
                self._by_id.setdefault(servo.servo_id, []).append(servo)

    def _drop_port(self, now_ns: int) -> None:
        """Take the port away while the servo restarts that is its USB device (FACTS.md P12)."""
        self._outages_ns.append((now_ns, now_ns + ns_from_s(self.motors.physics.usb_back_s)))
        self.has_outages = True
        self._host_line.lines.clear()

    # -- what the servos receive ----------------------------------------------------------------

    def _receive_until(self, now_ns: int) -> int:
        """Let the servos receive what is due; return `now_ns` in their time.

        The motors stand still until a servo is read or ordered.
        """
        if not self._is_started:
            self._start(now_ns)
        if self._drift.is_there:
            now_ns = self._drift.bus_ns(now_ns)
        self._now_ns = now_ns
        if self._host_line.lines or self._second_master.due_ns <= now_ns:
            while self._receive_next(now_ns):
                pass
        if self._faults.turns:
            self._turn_until(now_ns)
        return now_ns

    def _receive_next(self, until_ns: int) -> bool:
        """Let the servos receive the next line, of any host; False: none is due by `until_ns`."""
        lines, other_ns = self._host_line.lines, self._second_master.due_ns
        if lines and lines[0][0] <= other_ns:
            if lines[0][0] > until_ns:
                return False
            received_ns, sent = lines.popleft()
            self._servo_line.echo(sent, received_ns)
            sent = self.odd_lines.read(sent)
        elif other_ns <= until_ns:
            received_ns, sent = self._second_master.pop()
        else:
            return False
        if self._faults.turns:
            self._turn_until(received_ns)
        self.motors.follow(received_ns)
        for servo in self._rc_servos:
            servo.note_line(received_ns)
        faults = self._faults
        for line in faults.received(sent, received_ns) if faults.about_lines else (sent,):
            if self.lines is not None:
                at_ns = self._drift.host_ns(received_ns) if self._drift.is_there else received_ns
                self.lines.append((at_ns, line))
            self._deliver_to_servos(received_ns, line)
            if self._boards:
                self._deliver_to_boards(received_ns, line)
        return True

    def _deliver_to_servos(self, received_ns: int, line: bytes) -> None:
        commands = commands_in(line, grouped=self._is_ordered)
        answers: list[Answer] = []
        may_be_deaf = self._faults.deafness
        for command in commands:
            for servo in self._by_id.get(command.servo_id, ()):
                if may_be_deaf and self._faults.is_deaf(servo.servo_id, received_ns):
                    continue
                if servo.baud_bps != self.baud_bps or not servo.is_listening(received_ns):
                    continue
                if self.lines is not None:
                    self._note(servo.index, self.lines[-1])
                reply = servo.obey(command, received_ns)
                if reply is not None:
                    answers.append(Answer(servo, servo.servo_id, command, reply))
                if servo.deaf_until_ns > received_ns:  # It restarts.
                    self._sort_servos()
                    if servo is self._usb_servo:
                        self._drop_port(received_ns)
        if answers:
            self._answering.send(received_ns, commands, answers)

    def _deliver_to_boards(self, received_ns: int, line: bytes) -> None:
        for board in self._boards:
            is_deaf = board.baud_bps != self.baud_bps or not board.is_listening(received_ns)
            command = None if is_deaf else board.command_in(line, received_ns)
            if command is None:
                continue
            for pin in board.meant(command.servo_id):
                servo_id = pin.servo_id
                if not self._faults.is_deaf(servo_id, received_ns):
                    if pin.index is not None and self.lines is not None:
                        self._note(pin.index, self.lines[-1])
                    reply = board.obey(pin, command, received_ns)
                    if reply is not None:
                        answer = Answer(board, servo_id, command, reply)
                        self._answering.send(received_ns, [command], [answer])

    def _note(self, index: int, entry: tuple[int, bytes]) -> None:
        """Record a line that a servo received; one with several commands only once."""
        received = self.received[index]
        if not received or received[-1] != entry:
            received.append(entry)

    # -- faults ---------------------------------------------------------------------------------

    def _turn_until(self, now_ns: int) -> None:
        """Begin and end the faults of servos that are due."""
        while self._faults.turns and self._faults.turns[-1].due_ns <= now_ns:
            turn = self._faults.turns.pop()
            self.motors.advance(turn.due_ns)
            if turn.fault.kind is FaultKind.LOW_VOLTAGE:
                self.motors.supply(turn.due_ns, turn.fault.supply_v if turn.is_begin else None)
                continue
            for servo in self._servos:
                is_renumbered = turn.fault.kind is FaultKind.STORED
                known_id = self._set_up_ids[servo.index] if is_renumbered else servo.servo_id
                if turn.fault.servo_id in (None, known_id):
                    self._befall(servo.index, servo, turn)
            self._befall_boards(turn)

    def _befall(self, index: int, servo: Servo | None, turn: FaultEdge) -> None:
        fault = turn.fault
        match fault.kind:
            case (
                FaultKind.RESET
                | FaultKind.STORED
                | FaultKind.FACTORY
                | FaultKind.EXCHANGED
                | FaultKind.WRONG_SCALE
            ):
                self._befall_settings(index, servo, turn)
            case FaultKind.HOT:
                self.motors.heat(index, turn.due_ns, fault.temperature_c)
            case FaultKind.STUCK:
                self.motors.jam(index, turn.due_ns, is_jammed=turn.is_begin)
            case FaultKind.WEAK:
                ratio = fault.speed_ratio if turn.is_begin else 1.0
                self.motors.weaken(index, turn.due_ns, ratio)
            case FaultKind.INPUT:
                pass
            case _:
                raise AssertionError(f"{fault.kind} is not about a servo")

    def _befall_settings(self, index: int, servo: Servo | None, turn: FaultEdge) -> None:
        """Let a servo lose or change its settings; without `servo` it is an output of a board."""
        fault, at_ns = turn.fault, self._drift.host_ns(turn.due_ns)
        match fault.kind:
            case FaultKind.RESET:
                self.restarts_ns[index].append(at_ns)
                if servo is not None:
                    servo.reset(turn.due_ns, fault.deaf_s)
                    self._sort_servos()
            case FaultKind.STORED:
                self.stored_ns[index].append((at_ns, fault.settings))
                if servo is not None:
                    servo.store(fault.settings, turn.due_ns)
                    self._sort_servos()
            case FaultKind.FACTORY | FaultKind.EXCHANGED:
                self.restarts_ns[index].append(at_ns)
                if servo is not None:
                    anew = servo.renew if fault.kind is FaultKind.FACTORY else servo.exchange
                    anew(fault.settings, turn.due_ns, fault.deaf_s)
                    stored = {n: v for n, v in servo.settings.eeprom.items() if v is not None}
                    self.stored_ns[index].append((at_ns, stored))
                    self._sort_servos()
            case _ if servo is not None:
                servo.rescale(fault.setting, fault.scale_ratio, turn.due_ns)

    def _befall_boards(self, turn: FaultEdge) -> None:
        fault = turn.fault
        for board in self._boards:
            pins = board.pins if fault.servo_id is None else board.meant(fault.servo_id)
            if pins and fault.kind in RESTARTING:
                board.reset(turn.due_ns)
            if fault.kind is FaultKind.STORED:
                board.store(pins, fault.settings)
            for pin in pins:
                if pin.index is not None:
                    self._befall(pin.index, None, turn)
        if fault.kind is FaultKind.INPUT:
            self._set_input(fault.servo_id, fault.raw)

    def _set_input(self, servo_id: int | None, raw: int) -> None:
        for board in self._boards:
            for pin in board.pins if servo_id is None else board.meant(servo_id):
                pin.raw = raw


def _twins(servos: Sequence[ServoSpec], faults: Sequence[Fault]) -> list[ServoSpec]:
    """Return the servos that share the id of one of `servos`; each stands a little elsewhere."""
    return [
        replace(spec, start_deg=spec.start_deg + TWIN_DEG, hand=None)
        for fault in faults
        if fault.kind is FaultKind.TWIN
        for spec in servos
        if fault.servo_id in (None, spec.servo_id)
    ]


def _origin_deg(spec: ServoSpec) -> float:
    rows = storable(spec.model.language)
    return rows["O"].physical(spec.eeprom.get("O", 0)) if "O" in rows else 0.0


def set_up_settings(joint: Joint) -> dict[str, int]:
    """Return the stored settings with which the servo of `joint` is set up, as wire values.

    They are those of its robot file. What would take it from its line (baud rate, RC mode) and a
    first position are left out, because the simulated robot stands on its line when it begins.
    """
    stored = {
        name: stored_wire(joint.model.language, name, value)
        for name, value in joint.stored.items()
        if name not in ELSEWHERE
    }
    return {name: wire for name, wire in stored.items() if wire is not None}


def bus_from_robot(  # noqa: PLR0913  (the parameters of one bus)
    robot: Robot,
    bus_name: str,
    *,
    seed: int = 0,
    start_deg: Mapping[str, float] | None = None,
    physics: Physics | None = None,
    faults: Sequence[Fault] = (),
    usb_latency_ns: int = 0,
    hand: HandMotion | None = None,
    droop_deg: Mapping[str, float] | None = None,
    backlash_deg: Mapping[str, float] | None = None,
    pushes: Mapping[str, Push] | None = None,
) -> SimBus:
    """Return one bus of `robot`, its servos in the order of `servos_of`.

    `start_deg` gives joint angles at power-up by joint name. A joint left out stands at 0, or at
    the end of its range that is nearest to 0. Faults of other buses are left out. `hand` moves the
    joints that it names. `droop_deg` is the effect of the load on them, `backlash_deg` their play
    (`ServoSpec`), `pushes` what displaces them for a while.
    """
    bus = robot.buses[bus_name]
    asked_deg = start_deg or {}
    specs = []
    for joint in (robot.joints[name] for name in servos_of(robot, bus_name)):
        rest_deg = joint.within_deg(0.0)
        spec = ServoSpec(
            servo_id=joint.servo_id,
            model=joint.model,
            droop_deg=(droop_deg or {}).get(joint.name, 0.0),
            backlash_deg=(backlash_deg or {}).get(joint.name, 0.0),
            push=(pushes or {}).get(joint.name),
            eeprom=set_up_settings(joint),
            firmware=bus.firmware_of(joint.model.family),
        )
        raw = _raw_joint(joint, spec)
        stands_deg = raw.servo_deg(asked_deg.get(joint.name, rest_deg))
        led = None if hand is None else hand.led(raw)
        specs.append(replace(spec, start_deg=stands_deg, hand=led))
    return SimBus(
        specs,
        baud_bps=bus.baud_bps,
        firmware=bus.firmware,
        seed=seed,
        physics=physics,
        faults=[fault for fault in faults if fault.bus in (None, bus_name)],
        usb_latency_ns=usb_latency_ns,
        inputs={
            sensor.servo_id: SENSOR_FAR.get(sensor.kind, 0)
            for sensor in robot.sensors.values()
            if sensor.bus == bus_name
        },
    )


def _raw_joint(joint: Joint, spec: ServoSpec) -> Joint:
    """Return the joint whose servo angles count from the factory's zero, clockwise."""
    gyre = -1 if spec.eeprom.get("G", 1) == -1 else 1
    zero_deg = gyre * joint.zero_deg + _origin_deg(spec)
    return replace(joint, zero_deg=zero_deg, direction=1 if gyre == joint.direction else -1)


def servos_of(robot: Robot, bus_name: str) -> list[str]:
    """Return the names of the joints on a bus, in the order of the robot file."""
    return [joint.name for joint in robot.joints.values() if joint.bus == bus_name]


class SimPort:
    """A `SimBus` read and written at the instants of `clock`.

    After the bus was unplugged, `write` and `read` raise `BusError` for the rest of its life, as
    those of a real port do. Opening another port raises `BusError` until the bus is back. While the
    port is blocked it holds what is written, and raises when that takes too long.
    """

    def __init__(self, bus: SimBus, clock: Clock) -> None:
        self.url = "sim://"
        self.bus = bus
        self._clock = clock
        self._opened_ns = clock.now_ns()
        bus.advance(self._opened_ns)
        if any(from_ns <= self._opened_ns < until_ns for from_ns, until_ns in bus.outages_ns()):
            raise BusError(f"cannot open port {self.url}: it is unplugged", url=self.url)
        self._blocks_ns = bus.blocks_ns()
        self._outbox = Outbox(self.url, bus.baud_bps, self._take, lambda: 0)

    def write(self, data: bytes) -> None:
        if self.bus.has_outages:
            self._check_plugged()
        if self._blocks_ns:
            self._outbox.write(data, self._clock.now_ns())
        else:
            self.bus.write(data, self._clock.now_ns())

    def read(self) -> bytes:
        if self.bus.has_outages:
            self._check_plugged()
        if self._blocks_ns:
            self._outbox.flush(self._clock.now_ns())
        return self.bus.read(self._clock.now_ns())

    def fileno(self) -> int | None:
        return None

    def next_arrival_ns(self) -> int | None:
        if not self._blocks_ns:
            return self.bus.next_arrival_ns()
        instants_ns = (self.bus.next_arrival_ns(), *self._outbox_turns_ns())
        return min((at_ns for at_ns in instants_ns if at_ns is not None), default=None)

    def has_sent_all(self) -> bool:
        return not self._outbox.held_bytes

    def close(self) -> None:
        """Advance the bus until the servos have received what is still on the line.

        Raises `BlockedPortError` if the port does not take what it holds.
        """
        while self._outbox.held_bytes and self._is_plugged():
            turns_ns = [at_ns for at_ns in self._outbox_turns_ns() if at_ns is not None]
            self._clock.wait_until(min(turns_ns))
            self._outbox.flush(self._clock.now_ns())
        now_ns = self._clock.now_ns()
        self.bus.advance(now_ns + self.bus.backlog_ns(now_ns))

    def _outbox_turns_ns(self) -> tuple[int | None, int | None]:
        """Return when the port takes bytes again, and when it is lost if it does not."""
        if not self._outbox.held_bytes:
            return None, None
        return self._blocked_until_ns(), self._outbox.lost_ns

    def _take(self, data: bytes) -> int:
        if self._blocked_until_ns() is not None:
            return 0
        self.bus.write(data, self._clock.now_ns())
        return len(data)

    def _blocked_until_ns(self) -> int | None:
        """Return when the port takes bytes again; None: it does so now."""
        if not self._blocks_ns:
            return None
        now_ns = self._clock.now_ns()
        return max((z_ns for a_ns, z_ns in self._blocks_ns if a_ns <= now_ns < z_ns), default=None)

    def _is_plugged(self) -> bool:
        if not (outages_ns := self.bus.outages_ns()):
            return True
        now_ns = self._clock.now_ns()
        return not any(self._opened_ns < from_ns <= now_ns for from_ns, _ in outages_ns)

    def _check_plugged(self) -> None:
        """Raise `BusError` if the port was unplugged since it was opened."""
        if not self._is_plugged():
            raise LostPortError(f"lost port {self.url}: it was unplugged", url=self.url)
