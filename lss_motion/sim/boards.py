"""LSS-2IO boards in their 2RC mode: RC servos, analog pins and a LED behind a 16-byte buffer.

A board behaves as its factory sketch does (FACTS.md B), also where that differs from the page.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import Command, Reply
from lss_motion.protocol.io2 import (
    IO2_TABLE,
    OUTPUT_MAX_US,
    OUTPUT_MIN_US,
    PIN_IDS,
    PPM_MODE,
    SECTION_MAX_CHARS,
)
from lss_motion.protocol.table import Device, Form, Suffix
from lss_motion.sim.profile import FilterMove, PowerOff
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
OUTPUT_SPAN_US: Final = OUTPUT_MAX_US - OUTPUT_MIN_US
"""The board computes in 0 to 180 whole degrees and 544 to 2400 us (FACTS.md B6, B7)."""

START_US: Final = 1500
"""The pulse of an output before the first command; QD then answers 20 (FACTS.md B8)."""

CHANNELS: Final = 8
"""Channels of the receiver at a pin in PPM mode, all in the middle. Assumed."""
CHANNEL_US: Final = 1500

HIGH_MIN: Final = 128
"""An analog pin has no PWM: from here on its output is high (FACTS.md B18)."""

OUTPUT_MID_US: Final = (OUTPUT_MIN_US + OUTPUT_MAX_US) / 2

VALUE_MISSING: Final[Mapping[str, int]] = MappingProxyType({"D": 0, "P": 0, "LED": 0, "A": 0})
"""What the board takes for a value that is missing (FACTS.md B5)."""

_UNANSWERED_IDS: Final = (0, BROADCAST_ID)
"""Ids whose queries are obeyed by QMS only (FACTS.md B13, B22)."""

_SECTION: Final = re.compile(rb"#([0-9]+)([A-Za-z]+)(-?[0-9]+)?")
"""The part of a section that the board reads; it ignores what follows (FACTS.md B5)."""


class RangeSensor(NamedTuple):
    """A distance sensor as the board computes it: `scale / (raw - offset)`, clamped, in mm."""

    scale: int
    offset: int
    min_mm: int
    max_mm: int

    def distance_mm(self, raw: int) -> int:
        """Return the reply of the board.

        At or below the offset, as without a signal, it computes a negative distance, and -1 where
        it divides by 0; both are clamped to the nearest distance (FACTS.md B16).
        """
        if raw <= self.offset:
            return self.min_mm
        return min(max(self.scale // (raw - self.offset), self.min_mm), self.max_mm)

    def raw(self, distance_mm: float) -> int:
        """Return the value of the converter for an object at that distance."""
        distance_mm = min(max(distance_mm, self.min_mm), self.max_mm)
        return min(round(self.scale / distance_mm) + self.offset, RAW_MAX)


SENSORS: Final[Mapping[Suffix, RangeSensor]] = MappingProxyType(
    {
        Suffix.GP2Y0A41SK0F: RangeSensor(20760, 11, 30, 310),
        Suffix.GP2Y0A21YK0F: RangeSensor(48000, 20, 90, 810),
        Suffix.GP2Y0A02YK0F: RangeSensor(94620, 17, 190, 1510),
    }
)
"""From the published sketch (FACTS.md B15)."""

SENSOR_FAR: Final[Mapping[str, int]] = MappingProxyType(
    {suffix.name: sensor.raw(sensor.max_mm) for suffix, sensor in SENSORS.items()}
)
"""The value of the converter with nothing in front of a sensor, by its model."""


@dataclass(slots=True)
class Pin:
    """A pin of a board, with an id of its own. `index` is that of its RC servo, if it has one.

    `pulse_us` is the last command to the servo. `rc_pulse_us` are the pulses at which that servo
    stands at -90 and +90 degrees. `raw` is the value of an analog pin; None: nothing is connected.
    `is_high` is its level as an output; None: it is an input.
    """

    name: str
    device: Device
    servo_id: int
    index: int | None = None
    gyre: int = 1
    config_gyre: int = 1
    pulse_us: int = START_US
    rc_pulse_us: tuple[int, int] = (OUTPUT_MIN_US, OUTPUT_MAX_US)
    raw: int | None = None
    is_high: bool | None = None
    mode: int = 0
    config_mode: int = 0

    def attach(self, index: int, spec: ServoSpec) -> None:
        """Put the RC servo `spec` on the pin, which takes its id and its gyre."""
        self.index = index
        self.servo_id = spec.servo_id
        self.gyre = self.config_gyre = spec.eeprom.get("G", 1)
        self.rc_pulse_us = spec.model.units.rc_pulse_us


def make_boards(
    outputs: Sequence[tuple[int, ServoSpec]],
    inputs: Mapping[int, int],
    motors: Motors,
    *,
    baud_bps: int,
    random: Random,
) -> list[Board]:
    """Return the boards that `outputs` (motor index, RC servo) and `inputs` (id, value) need.

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


def _attach_inputs(boards: Sequence[Board], inputs: Mapping[int, int]) -> None:
    """Give analog pins the requested ids and their values; a pin with such an id keeps it."""
    pins = [pin for board in boards for pin in board.pins if pin.device is Device.ANALOG]
    ids = list(dict.fromkeys(inputs))
    kept = []
    for pin in pins:
        if pin.servo_id in ids:
            ids.remove(pin.servo_id)
            kept.append(pin)
    for servo_id, pin in zip(ids, [pin for pin in pins if pin not in kept], strict=False):
        pin.servo_id = servo_id
        kept.append(pin)
    for pin in kept:
        pin.raw = inputs[pin.servo_id]


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
        """Return the pins that an id addresses: the first that has it (FACTS.md B22)."""
        if servo_id == BROADCAST_ID:
            return self.pins
        return [pin for pin in self.pins if pin.servo_id == servo_id][:1]

    def obey(self, pin: Pin, command: Command, now_ns: int) -> Reply | None:
        """Execute a command on one pin; return the reply to a query.

        A pin ignores commands that it does not have, and broadcast queries but QMS.
        """
        found = IO2_TABLE.by_keyword.get(command.keyword)
        if found is None:
            return None
        form, row = found
        if row.devices and pin.device not in row.devices:
            return None
        value = command.value if isinstance(command.value, int) else None
        if form is Form.QUERY:
            is_answered = row.name == "MS" or command.servo_id not in _UNANSWERED_IDS
            answer = self._value(pin, row, value) if is_answered else None
            return None if answer is None else Reply(pin.servo_id, command.keyword, answer)
        self._execute(pin, row, value, now_ns, is_config=form is Form.CONFIG)
        return None

    def reset(self, now_ns: int) -> None:
        """Restart with the configured values; no pulses are sent until the next D or P."""
        self._deaf_until_ns = now_ns + RESET_NS
        self._led = self._config_led
        for pin in self.pins:
            pin.gyre, pin.mode = pin.config_gyre, pin.config_mode
            pin.pulse_us, pin.is_high = START_US, None
            self._release(pin, now_ns)

    def store(self, pins: Sequence[Pin], settings: Mapping[str, int]) -> None:
        """Take wire values of some pins at once, also for every later start; they have G and ID."""
        for pin in pins:
            pin.gyre = pin.config_gyre = settings.get("G", pin.config_gyre)
            pin.servo_id = settings.get("ID", pin.servo_id)

    def _restore_factory(self, now_ns: int) -> None:
        """Reset all values at once, ids and rate as well ("all values": FACTS.md B14)."""
        self.baud_bps = IO2_TABLE.row("QB").default or self.baud_bps
        self._config_led = 0
        for pin in self.pins:
            pin.servo_id = PIN_IDS[pin.name]
            pin.config_gyre, pin.config_mode = 1, 0
        self.reset(now_ns)

    def _execute(
        self, pin: Pin, row: Row, value: int | None, now_ns: int, *, is_config: bool
    ) -> None:
        """Execute an action or a configuration."""
        value = VALUE_MISSING.get(row.name) if value is None else value
        match row.name, value:
            case "RESET", _:
                self.reset(now_ns)
            case "DEFAULT", _:
                self._restore_factory(now_ns)
            case "L", _:
                self._release(pin, now_ns)
            case "D", int():  # The board bounds what it computes from it.
                self._aim(pin, "D", value, now_ns)
            case _, int() if (kept := row.kept(value)) is not None:
                self._set(pin, row.name, kept, now_ns, is_config=is_config)
            case _:
                pass

    def _set(self, pin: Pin, name: str, value: int, now_ns: int, *, is_config: bool) -> None:
        match name:
            case "P":
                self._aim(pin, name, value, now_ns)
            case "AM":
                pin.mode = pin.config_mode = value
            case "A":
                pin.is_high = value > 0 if pin.name == "A4" else value >= HIGH_MIN
            case "G":
                pin.gyre = value
                if is_config:
                    pin.config_gyre = value
            case "LED":
                self._led = value
                if is_config:
                    self._config_led = value
            case "ID":
                pin.servo_id = value
            case _:
                self.baud_bps = value

    def _aim(self, pin: Pin, name: str, value: int, now_ns: int) -> None:
        """Send an output's pulse for D or P; the gyre mirrors D only (FACTS.md B9).

        The library of the sketch takes a number of degrees from 544 on for a pulse (FACTS.md B6).
        """
        if name == "D":
            value = (pin.gyre * value + 900) * DEG_MAX // 1800
            if value < OUTPUT_MIN_US:
                written_deg = min(max(value, 0), DEG_MAX)
                value = OUTPUT_MIN_US + written_deg * OUTPUT_SPAN_US // DEG_MAX
        self._jump(pin, min(max(value, OUTPUT_MIN_US), OUTPUT_MAX_US), now_ns)

    def _value(self, pin: Pin, row: Row, suffix: int | None) -> int | str | None:
        """Return the value of the reply to a query; None: no reply."""
        match row.name:
            case "D":  # With a gyre of -1 the sketch forgets the middle: nonsense (FACTS.md B9).
                read_deg = (pin.pulse_us + 1 - OUTPUT_MIN_US) * DEG_MAX // OUTPUT_SPAN_US
                return 10 * pin.gyre * read_deg - 900
            case "MS":
                return f"LSS-2IO-{'LED' if pin.device is Device.MASTER else pin.name}"
            case "A":
                return self._analog(pin, row, suffix)
            case _:
                known = {"P": pin.pulse_us, "ID": pin.servo_id, "G": pin.gyre}
                return (known | {"LED": self._led, "B": self.baud_bps}).get(row.name)

    def _analog(self, pin: Pin, row: Row, suffix: int | None) -> int | str:
        """Return the value of an analog pin: raw, as a distance, or the pulses of a receiver."""
        if pin.mode == PPM_MODE:
            return "".join([f",{CHANNEL_US}"] * CHANNELS)
        read = self._read(pin)
        raw = read if pin.gyre == 1 else RAW_MAX + 1 - read
        meaning = None if suffix is None else (row.suffixes or {}).get(suffix)
        return raw if meaning is None else SENSORS[meaning].distance_mm(raw)

    def _read(self, pin: Pin) -> int:
        """Return the value of the converter; with nothing connected it is random (FACTS.md B17)."""
        if pin.is_high is not None:
            return RAW_MAX if pin.is_high else 0
        return self.random.randint(0, RAW_MAX) if pin.raw is None else pin.raw

    def _jump(self, pin: Pin, pulse_us: int, now_ns: int) -> None:
        """Send the pulse: an RC servo moves there as fast as it can.

        Its angle counts from the middle of the outputs, where D is 0.
        """
        pin.pulse_us = pulse_us
        if pin.index is not None:
            low_us, high_us = pin.rc_pulse_us
            raw_deg = (pulse_us - OUTPUT_MID_US) * DEG_MAX / (high_us - low_us)
            chase = FilterMove(raw_deg, filter_count=1, is_repeated=False)
            self._motors.order(pin.index, now_ns, chase)

    def _release(self, pin: Pin, now_ns: int) -> None:
        if pin.index is not None:
            self._motors.order(pin.index, now_ns, PowerOff())

    def _overrun(self, now_ns: int) -> None:
        if self.random.random() < OVERRUN_JUMP_RATIO:
            outputs = [pin for pin in self.pins if pin.device is Device.SERVO]
            pin = self.random.choice(outputs)
            self._aim(pin, "D", self.random.randint(-900, 900), now_ns)


def _device(name: str) -> Device:
    match name[0]:
        case "M":
            return Device.MASTER
        case "A":
            return Device.ANALOG
        case _:
            return Device.SERVO
