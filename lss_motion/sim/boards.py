"""LSS-2IO boards in their 2RC mode: RC servos, analog inputs and a LED behind a 16-byte buffer."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.protocol.constants import BROADCAST_ID, PULSE_MAX_US, PULSE_MIN_US
from lss_motion.protocol.framing import Command, Reply
from lss_motion.protocol.io2 import IO2_TABLE, PIN_IDS, SECTION_MAX_CHARS
from lss_motion.protocol.table import Device, Form, Suffix
from lss_motion.sim.profile import Chase, Limp
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from random import Random

    from lss_motion.protocol.table import Row
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.physics import ServoSpec

RESET_NS: Final = 30 * NS_PER_MS
"""How long a board is deaf after RESET: the watchdog's time (FACTS.md B14). What its boot loader
adds is not known."""

OVERRUN_JUMP_RATIO: Final = 0.5
"""How often a section that overruns the buffer makes an output jump. Assumed: what the bytes
beyond the buffer overwrite depends on the build (FACTS.md B4: nothing checks it)."""

RAW_MAX: Final = 1023
"""Ten bits of the converter (FACTS.md B9: a gyre of -1 answers 1024 minus the value)."""

DEG_MAX: Final = 180
PULSE_SPAN_US: Final = PULSE_MAX_US - PULSE_MIN_US
"""The board computes in 0 to 180 whole degrees and 500 to 2500 us (FACTS.md B6, B7)."""

_SECTION: Final = re.compile(rb"#([0-9]+)([A-Za-z]+)(-?[0-9]+)?")
"""The part of a section that the board reads; it ignores what follows (FACTS.md B5)."""


class Sensor(NamedTuple):
    """A distance sensor as the board computes it: `scale / (raw - offset)`, clamped, in mm."""

    scale: int
    offset: int
    min_mm: int
    max_mm: int

    def distance_mm(self, raw: int) -> int:
        """Return the reply of the board. At or below the offset no object is near (assumed)."""
        if raw <= self.offset:
            return self.max_mm
        return min(max(self.scale // (raw - self.offset), self.min_mm), self.max_mm)

    def raw(self, distance_mm: float) -> int:
        """Return the value of the converter for an object at that distance."""
        distance_mm = min(max(distance_mm, self.min_mm), self.max_mm)
        return min(round(self.scale / distance_mm) + self.offset, RAW_MAX)


SENSORS: Final[Mapping[Suffix, Sensor]] = MappingProxyType(
    {
        Suffix.GP2Y0A41SK0F: Sensor(20760, 11, 30, 310),
        Suffix.GP2Y0A21YK0F: Sensor(48000, 20, 90, 810),
        Suffix.GP2Y0A02YK0F: Sensor(94620, 17, 190, 1510),
    }
)
"""From the published sketch (FACTS.md B15)."""


@dataclass(slots=True)
class Pin:
    """A pin of a board, with an id of its own. `index` is that of its RC servo, if it has one.

    `written_deg` and `pulse_us` are the last command to the servo, 0 to 180 and 500 to 2500.
    """

    name: str
    device: Device
    servo_id: int
    index: int | None = None
    gyre: int = 1
    config_gyre: int = 1
    written_deg: int = DEG_MAX // 2
    pulse_us: int = (PULSE_MIN_US + PULSE_MAX_US) // 2
    raw: int = 0

    def attach(self, index: int, spec: ServoSpec) -> None:
        """Put the RC servo `spec` on the pin, which takes its id and its gyre."""
        self.index = index
        self.servo_id = spec.servo_id
        self.gyre = self.config_gyre = spec.eeprom.get("G", 1)


def make_boards(
    outputs: Sequence[tuple[int, ServoSpec]],
    inputs: Sequence[int],
    motors: Motors,
    *,
    baud_bps: int,
    random: Random,
) -> list[Board]:
    """Return the boards that `outputs` (motor index, RC servo) and `inputs` (ids) need.

    A board has three of each.

    A servo with the default id of a pin is on that pin; another is on the first free pin. All
    other pins have their default ids on every board. Two boards therefore have masters with the
    same id, which execute and answer at once, as on a real bus before new ids are set.
    """
    needed = -(-max(len(outputs), len(inputs)) // 3)
    boards = [Board(motors, baud_bps=baud_bps, random=random) for _ in range(needed)]
    _attach_inputs(boards, inputs)
    left = []
    for index, spec in outputs:
        free = (board.pin(spec.servo_id) for board in boards)
        pin = next((p for p in free if p is not None and p.index is None), None)
        if pin is None or pin.device is not Device.SERVO:
            left.append((index, spec))
        else:
            pin.attach(index, spec)
    for index, spec in left:
        pins = (pin for board in boards for pin in board.pins)
        pin = next(p for p in pins if p.device is Device.SERVO and p.index is None)
        pin.attach(index, spec)
    return boards


def _attach_inputs(boards: Sequence[Board], inputs: Sequence[int]) -> None:
    """Give analog pins the requested ids; a pin that already has one of them keeps it."""
    pins = [pin for board in boards for pin in board.pins if pin.device is Device.ANALOG]
    ids = list(dict.fromkeys(inputs))
    kept = []
    for pin in pins:
        if pin.servo_id in ids:
            ids.remove(pin.servo_id)
            kept.append(pin)
    for servo_id, pin in zip(ids, [pin for pin in pins if pin not in kept], strict=False):
        pin.servo_id = servo_id


class Board:
    """One board: all its pins share one line buffer, one baud rate and one transmitter.

    `sent_ns` is when its last reply ends.
    """

    def __init__(self, motors: Motors, *, baud_bps: int, random: Random) -> None:
        self.random = random
        self.sent_ns = 0
        self.baud_bps = baud_bps
        self.pins = [Pin(name, _device(name), servo_id) for name, servo_id in PIN_IDS.items()]
        self._motors = motors
        self._deaf_until_ns = 0
        self._led = self._config_led = 0

    def pin(self, servo_id: int) -> Pin | None:
        return next((pin for pin in self.pins if pin.servo_id == servo_id), None)

    def is_listening(self, now_ns: int) -> bool:
        return now_ns >= self._deaf_until_ns

    def command_in(self, line: bytes, now_ns: int) -> Command | None:
        """Return the command that the board reads from a line. The line may be for other servos.

        Every `#` restarts the buffer, so the last section counts. A section of more than 15
        characters overruns it: it is lost and may make an output jump, whatever its id is.
        """
        sections = [b"#" + section for section in line.removesuffix(b"\r").split(b"#")[1:]]
        for section in sections:
            if len(section) > SECTION_MAX_CHARS:
                self._overrun(now_ns)
        if not sections or len(sections[-1]) > SECTION_MAX_CHARS:
            return None
        match = _SECTION.match(sections[-1])
        if match is None:
            return None
        value = None if match[3] is None else int(match[3])
        return Command(int(match[1]), match[2].decode("ascii").upper(), value)

    def meant(self, servo_id: int) -> list[Pin]:
        """Return the pins that an id addresses."""
        if servo_id == BROADCAST_ID:
            return self.pins
        return [pin for pin in self.pins if pin.servo_id == servo_id]

    def obey(self, pin: Pin, command: Command, now_ns: int) -> Reply | None:
        """Execute a command on one pin; return the reply to a query.

        A pin ignores commands that it does not have, and broadcast queries.
        """
        is_broadcast = command.servo_id == BROADCAST_ID
        found = IO2_TABLE.by_keyword.get(command.keyword)
        if found is None:
            return None
        form, row = found
        if row.devices and pin.device not in row.devices:
            return None
        if is_broadcast and row.name == "ID":  # Assumed: otherwise all pins would get one id.
            return None
        value = command.value if isinstance(command.value, int) else None
        if form is Form.QUERY:
            answer = None if is_broadcast else self._value(pin, row, value)
            return None if answer is None else Reply(pin.servo_id, command.keyword, answer)
        match row.name:
            case "RESET":
                self.reset(now_ns)
            case "DEFAULT":
                self._restore_factory(now_ns)
            case "L":
                self._release(pin, now_ns)
            case _:
                kept = None if value is None else row.kept(value)
                if kept is not None:
                    self._set(pin, row.name, kept, now_ns, is_config=form is Form.CONFIG)
        return None

    def reset(self, now_ns: int) -> None:
        """Restart with the configured values; no pulses are sent until the next D or P."""
        self._deaf_until_ns = now_ns + RESET_NS
        self._led = self._config_led
        for pin in self.pins:
            self._turn(pin, pin.config_gyre)
            pin.written_deg, pin.pulse_us = DEG_MAX // 2, (PULSE_MIN_US + PULSE_MAX_US) // 2
            self._release(pin, now_ns)

    def store(self, pins: Sequence[Pin], settings: Mapping[str, int]) -> None:
        """Take wire values of some pins at once, also for every later start; they have G and ID."""
        for pin in pins:
            pin.config_gyre = settings.get("G", pin.config_gyre)
            self._turn(pin, pin.config_gyre)
            pin.servo_id = settings.get("ID", pin.servo_id)

    def _restore_factory(self, now_ns: int) -> None:
        """Reset all values at once, ids and rate as well ("all values": FACTS.md B14)."""
        self.baud_bps = IO2_TABLE.row("QB").default or self.baud_bps
        self._config_led = 0
        for pin in self.pins:
            pin.servo_id = PIN_IDS[pin.name]
            pin.config_gyre = 1
        self.reset(now_ns)

    def _set(self, pin: Pin, name: str, value: int, now_ns: int, *, is_config: bool) -> None:
        match name:
            case "D":
                turned = (value + 900) * DEG_MAX // 1800 - DEG_MAX // 2
                pin.written_deg = DEG_MAX // 2 + pin.gyre * turned
                pin.pulse_us = PULSE_MIN_US + pin.written_deg * PULSE_SPAN_US // DEG_MAX
                self._jump(pin, pin.written_deg - DEG_MAX / 2, now_ns)
            case "P":
                pin.pulse_us = value if pin.gyre == 1 else PULSE_MIN_US + PULSE_MAX_US - value
                pulse_us = pin.pulse_us - PULSE_MIN_US
                pin.written_deg = pulse_us * DEG_MAX // PULSE_SPAN_US
                self._jump(pin, pulse_us * DEG_MAX / PULSE_SPAN_US - DEG_MAX / 2, now_ns)
            case "G":
                self._turn(pin, value)
                if is_config:
                    pin.config_gyre = value
            case "LED":
                self._led = value
                if is_config:
                    self._config_led = value
            case "ID":
                pin.servo_id = value
            case "B":
                self.baud_bps = value
            case _:
                raise AssertionError(f"{name} is in the table and nowhere else")

    def _value(self, pin: Pin, row: Row, suffix: int | None) -> int | str | None:
        """Return the value of the reply to a query; None: no reply."""
        match row.name:
            case "D":  # With a gyre of -1 the sketch forgets the middle: nonsense (FACTS.md B9).
                return 10 * pin.gyre * pin.written_deg - 900
            case "P":
                return pin.pulse_us if pin.gyre == 1 else PULSE_MIN_US + PULSE_MAX_US - pin.pulse_us
            case "G":
                return pin.gyre
            case "LED":
                return self._led
            case "B":
                return self.baud_bps
            case "MS":
                return f"LSS-2IO-{'LED' if pin.device is Device.MASTER else pin.name}"
            case "A":
                raw = pin.raw if pin.gyre == 1 else RAW_MAX + 1 - pin.raw
                meaning = None if suffix is None else (row.suffixes or {}).get(suffix)
                return raw if meaning is None else SENSORS[meaning].distance_mm(raw)
            case _:
                return None

    def _turn(self, pin: Pin, gyre: int) -> None:
        pin.gyre = gyre
        if pin.index is not None:
            self._motors.gyre[pin.index] = gyre

    def _jump(self, pin: Pin, raw_deg: float, now_ns: int) -> None:
        """Send the pulse: an RC servo moves there as fast as it can."""
        if pin.index is not None:
            chase = Chase(raw_deg, filter_count=1, is_repeated=False)
            self._motors.order(pin.index, now_ns, chase)

    def _release(self, pin: Pin, now_ns: int) -> None:
        if pin.index is not None:
            self._motors.order(pin.index, now_ns, Limp())

    def _overrun(self, now_ns: int) -> None:
        if self.random.random() < OVERRUN_JUMP_RATIO:
            outputs = [pin for pin in self.pins if pin.device is Device.SERVO]
            pin = self.random.choice(outputs)
            self._set(pin, "D", self.random.randint(-900, 900), now_ns, is_config=False)


def _device(name: str) -> Device:
    match name[0]:
        case "M":
            return Device.MASTER
        case "A":
            return Device.ANALOG
        case _:
            return Device.SERVO
