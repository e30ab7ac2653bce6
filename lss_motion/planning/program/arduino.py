"""A program as an Arduino sketch for the maker's library (LSS), which plays it without a computer.

`sketch` returns two files: the sketch, and a header with the commands in flash memory. The sketch
sends the settings of the show, asks every servo where it stands, approaches the start at the
approach speed of the robot, plays, and ends as the robot file says. It has no feedback while it
plays: it cannot notice a servo that restarts or stalls.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.planning.program.moves import standing_wire
from lss_motion.planning.program.reference_grid import servo_limits
from lss_motion.protocol.constants import Family
from lss_motion.units import MS_PER_S, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from lss_motion.planning.program.model import Program
    from lss_motion.protocol.framing import Command
    from lss_motion.robot.model import Joint, Robot

HEAD: Final = "// lss_motion sketch"
"""How both files begin; `files.output.Kind.ARDUINO` knows them by it."""

INT16_MAX: Final = 32_767
"""The library takes values as `int16_t` (FACTS.md F18)."""

DURATION_MAX_S: Final = 4_000.0
"""`micros()` of an Arduino begins again after 4,294 s."""

APPROACH_LEAST_MS: Final = 300
"""As `playing.player.session.APPROACH_LEAST_S`: a servo that stands in its place may be limp."""

SETTLE_MS: Final = 500
"""Chosen: between the approach and the show, for servos that arrive later than their T."""

ORDER_BYTES: Final = 10
"""Flash memory of one command."""

AVR_TABLE_MAX_BYTES: Final = 32_767
"""An array is no larger in a program for 8-bit boards: `ptrdiff_t` has 16 bits there (avr-gcc)."""

_STEM: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,62}", re.ASCII)
"""Names of sketches that the Arduino IDE accepts."""


class Sketch(NamedTuple):
    """The texts of the two files, what of the show they do not contain, and what they need."""

    sketch: str
    header: str
    left_out: tuple[str, ...]
    notes: tuple[str, ...] = ()


class _Order(NamedTuple):
    due_us: int
    servo_id: int
    value: int
    duration_ms: int
    is_led: bool


def header_name(path: Path) -> str:
    """Return the name of the header beside the sketch at `path`."""
    return f"{path.stem}_program.h"


def sketch(program: Program, robot: Robot, settings: Iterable[Command], path: Path) -> Sketch:
    """Return the sketch at `path` and its header, or raise `InputError` for what it cannot play.

    `settings` are the session settings of the show, which the sketch sends first.
    """
    robot = robot.servo_robot
    joints = [robot.joints[name] for name in program.start_deg]
    _check(program, joints, path)
    orders = _orders(program, robot)
    for order in orders:
        if abs(order.value) > INT16_MAX or order.duration_ms > INT16_MAX:
            raise InputError(
                f"servo {order.servo_id} would get D{order.value}T{order.duration_ms}; the library "
                f"takes numbers up to {INT16_MAX}",
                path=path,
            )
    left_out = [f"say: {cue.say!r:.60}" for cue in program.cues if cue.say]
    left_out += [f"run: {cue.run!r:.60}" for cue in program.cues if cue.run]
    left_out += [f"sound: {cue.sound!r:.60}" for cue in program.cues if cue.sound]
    name = _shown(program.name)
    head = [
        f"{HEAD}: {name} for robot {_shown(robot.name)}, {counted(program.moves, 'command')}, "
        f"{ORDER_BYTES * len(orders)} bytes of flash memory.",
        *(f"// Not carried over: {_shown(text)}" for text in left_out),
    ]
    notes = _notes(ORDER_BYTES * len(orders))
    too_large = [line for note in notes for line in ("#ifdef __AVR__", f"#error {note}", "#endif")]
    tables = _header(program, robot, joints, list(settings), orders)
    header = "\n".join([*head, *too_large, *tables, ""])
    body = _SKETCH.format(head=head[0], header=header_name(path), least=APPROACH_LEAST_MS,
                          settle=SETTLE_MS)  # fmt: skip
    return Sketch(body, header, tuple(left_out), notes)


def _notes(table_bytes: int) -> tuple[str, ...]:
    if table_bytes <= AVR_TABLE_MAX_BYTES:
        return ()
    return (
        f"the commands take {table_bytes} bytes and an 8-bit board (Uno, Nano, Mega) takes "
        f"{AVR_TABLE_MAX_BYTES} at most: use a 32-bit board, or a shorter show",
    )


def _check(program: Program, joints: Sequence[Joint], path: Path) -> None:
    if _STEM.fullmatch(path.stem) is None:
        raise InputError(
            "the Arduino IDE allows letters, digits, _ and - in the name of a sketch", path=path
        )
    if program.waits:
        raise InputError("a show that waits for a sensor cannot be played by a sketch", path=path)
    if len({joint.bus for joint in joints}) > 1:
        raise InputError("a sketch plays one bus only; the show uses more", path=path)
    for joint in joints:
        if joint.model.family is not Family.LSS:
            raise InputError(
                f"joint {joint.name!r} is a {joint.model.family} servo; the library of a sketch is "
                "for LSS. Leave it out of this show, or play the show with lss-play",
                path=path,
            )
        if joint.name in program.drives:
            raise InputError(
                f"joint {joint.name!r} is {program.drives[joint.name].drive}; a sketch plays "
                "`drive: timed` only",
                path=path,
            )
    if program.pass_s > DURATION_MAX_S:
        raise InputError(
            f"takes {program.pass_s:g} s; a sketch plays at most {DURATION_MAX_S:g} s", path=path
        )


def _orders(program: Program, robot: Robot) -> list[_Order]:
    """Return moves and colours in order of time. Moves of a repeated program end with its pass."""
    end_us = us_from_s(program.pass_s)
    orders = [
        _Order(move.due_us, move.servo_id, move.target_wire, move.duration_ms or 0, is_led=False)
        for move in program.moves
        if program.repeat is None or move.due_us < end_us
    ]
    for cue in program.cues:
        if program.repeat is None or us_from_s(cue.at_s) < end_us:
            orders += [
                _Order(us_from_s(cue.at_s), robot.joints[name].servo_id, int(code), 0, is_led=True)
                for name, code in cue.led
            ]
    return sorted(orders, key=lambda order: order.due_us)


def _header(
    program: Program,
    robot: Robot,
    joints: Sequence[Joint],
    settings: Sequence[Command],
    orders: Sequence[_Order],
) -> list[str]:
    lead_us = max(0, -min((order.due_us for order in orders), default=0))
    repeat = program.repeat
    first = 0
    if repeat is not None:
        first = next(
            (n for n, order in enumerate(orders) if order.due_us >= repeat.from_us), len(orders)
        )
    period_us = 0 if repeat is None else repeat.to_us - repeat.from_us
    bus = robot.buses[joints[0].bus]
    wire_per_deg = joints[0].model.wire_per_deg
    end = "LSS_ActionLimp" if robot.end == "limp" else "LSS_ActionHold"
    starts = (
        f"  {{{j.servo_id}, {standing_wire(j.servo_deg(program.start_deg[j.name]), limits)}}},"
        f"  // {_shown(j.name)}"
        for j in joints
        for limits in (servo_limits(j, program.tolerance_deg),)
    )
    return [
        "#pragma once",
        "#include <Arduino.h>",
        "#include <LSS.h>",
        "",
        f"const uint32_t SHOW_BAUD = {bus.baud_bps};",
        f"const uint32_t SHOW_LEAD_US = {lead_us};  // The first command comes so long before 0.",
        f"const uint32_t SHOW_END_US = {us_from_s(program.pass_s)};",
        f"const uint32_t SHOW_PERIOD_US = {period_us};  // 0: played once.",
        f"const uint32_t SHOW_FIRST_REPEATED = {first};",
        "const int32_t SHOW_APPROACH_PER_S = "
        f"{max(1, round(robot.approach_speed_deg_s * wire_per_deg))};  // Tenths of a degree.",
        f"#define SHOW_END_ACTION {end}",
        "",
        *_tables(joints, starts, settings, orders, lead_us),
    ]


def _tables(
    joints: Sequence[Joint],
    starts: Iterable[str],
    settings: Sequence[Command],
    orders: Sequence[_Order],
    lead_us: int,
) -> list[str]:
    """Return servos with their starts, settings, and commands."""
    return [
        "struct ShowServo {",
        "  uint8_t id;",
        "  int16_t start;  // Tenths of a degree.",
        "};",
        f"const uint8_t SHOW_SERVOS_COUNT = {len(joints)};",
        "const ShowServo SHOW_SERVOS[] PROGMEM = {",
        *starts,
        "};",
        "",
        "struct ShowSetting {",
        "  uint8_t id;",
        "  char keyword[8];",
        "  int16_t value;",
        "};",
        f"const uint8_t SHOW_SETTINGS_COUNT = {len(settings)};",
        "const ShowSetting SHOW_SETTINGS[] PROGMEM = {",
        *(f'  {{{c.servo_id}, "{c.keyword}", {c.value}}},' for c in settings),
        "};",
        "",
        "struct __attribute__((packed)) ShowOrder {",
        "  uint32_t due_us;  // After the first command.",
        "  int16_t value;    // Tenths of a degree, or a colour.",
        "  uint16_t time_ms;",
        "  uint8_t id;",
        "  uint8_t is_led;",
        "};",
        f"const uint32_t SHOW_ORDERS_COUNT = {len(orders)};",
        "const ShowOrder SHOW_ORDERS[] PROGMEM = {",
        *(
            f"  {{{o.due_us + lead_us}, {o.value}, {o.duration_ms}, {o.servo_id}, "
            f"{int(o.is_led)}}},  // {s_from_us(o.due_us):.3f} s"
            for o in orders
        ),
        "};",
    ]


def _shown(text: str) -> str:
    """Return `text` for a comment: one line that does not end in a backslash."""
    return "".join(char if char.isprintable() and char != "\\" else "?" for char in text)


assert MS_PER_S == 1000, "the sketch computes in ms"

_SKETCH: Final = """\
{head}
// Needs the library "LSS" of Lynxmotion (Arduino IDE: Tools, Manage Libraries). The folder of the
// sketch must have the name of the sketch.
#include <Arduino.h>
#include <LSS.h>
#include "{header}"

// The port of the servo bus. A board with one port (Uno) shares it with the USB cable: pull the
// cable, or use a board with more ports and write Serial1 here.
#define SHOW_PORT Serial

// A button between this pin and ground holds all servos at once. -1: no button.
const int8_t STOP_PIN = -1;

const uint8_t TRIES = 3;
const uint16_t APPROACH_LEAST_MS = {least};
const uint16_t SETTLE_MS = {settle};
const int32_t TIME_MAX_MS = 30000;

static bool is_playing = false;
static uint32_t start_us = 0;
static uint32_t next_order = 0;
static int16_t positions[SHOW_SERVOS_COUNT];

static ShowServo servo_at(uint8_t index) {{
  ShowServo servo;
  memcpy_P(&servo, &SHOW_SERVOS[index], sizeof servo);
  return servo;
}}

static ShowOrder order_at(uint32_t index) {{
  ShowOrder order;
  memcpy_P(&order, &SHOW_ORDERS[index], sizeof order);
  return order;
}}

static bool is_stopped() {{
  return STOP_PIN >= 0 && digitalRead(STOP_PIN) == LOW;
}}

static void end_show(const char *action) {{
  for (uint8_t index = 0; index < SHOW_SERVOS_COUNT; ++index) {{
    LSS::genericWrite(servo_at(index).id, action);
  }}
  is_playing = false;
}}

// Read where every servo stands. Nothing has moved yet if one of them is silent.
static bool read_positions() {{
  for (uint8_t index = 0; index < SHOW_SERVOS_COUNT; ++index) {{
    const uint8_t id = servo_at(index).id;
    LSS servo(id);
    bool is_read = false;
    for (uint8_t tries = 0; tries < TRIES && !is_read; ++tries) {{
      positions[index] = LSS::genericRead_Blocking_s16(id, LSS_QueryPosition);
      is_read = servo.getLastCommStatus() == LSS_CommStatus_ReadSuccess;
    }}
    if (!is_read) {{
      return false;
    }}
  }}
  return true;
}}

static void send_settings() {{
  for (uint8_t index = 0; index < SHOW_SETTINGS_COUNT; ++index) {{
    ShowSetting setting;
    memcpy_P(&setting, &SHOW_SETTINGS[index], sizeof setting);
    LSS::genericWrite(setting.id, setting.keyword, setting.value);
  }}
}}

static bool wait_ms(uint32_t duration_ms) {{
  const uint32_t from_ms = millis();
  while (millis() - from_ms < duration_ms) {{
    if (is_stopped()) {{
      end_show(LSS_ActionHold);
      return false;
    }}
  }}
  return true;
}}

// Move all servos to the start of the show. All take equally long, none is faster than allowed.
static bool approach() {{
  int32_t left_ms;
  do {{
    left_ms = APPROACH_LEAST_MS;
    for (uint8_t index = 0; index < SHOW_SERVOS_COUNT; ++index) {{
      const int32_t way = (int32_t)servo_at(index).start - positions[index];
      const int64_t far = way < 0 ? -way : way;
      const int32_t needed_ms = (int32_t)(far * 1000 / SHOW_APPROACH_PER_S) + 1;
      left_ms = needed_ms > left_ms ? needed_ms : left_ms;
    }}
    const int32_t step_ms = left_ms < TIME_MAX_MS ? left_ms : TIME_MAX_MS;
    for (uint8_t index = 0; index < SHOW_SERVOS_COUNT; ++index) {{
      const ShowServo servo = servo_at(index);
      const int32_t way = (int32_t)servo.start - positions[index];
      positions[index] += (int16_t)(way * (int64_t)step_ms / left_ms);
      LSS::genericWrite(servo.id, LSS_ActionMove, positions[index], LSS_ActionParameterTime,
                        (int16_t)step_ms);
    }}
    if (!wait_ms((uint32_t)step_ms)) {{
      return false;
    }}
  }} while (left_ms > TIME_MAX_MS);
  return wait_ms(SETTLE_MS);
}}

void setup() {{
  if (STOP_PIN >= 0) {{
    pinMode(STOP_PIN, INPUT_PULLUP);
  }}
  LSS::initBus(SHOW_PORT, SHOW_BAUD);
  delay(1500);  // A servo that has just got its power is deaf for 1.25 s.
  if (!read_positions()) {{
    return;
  }}
  send_settings();
  if (approach()) {{
    start_us = micros();
    is_playing = true;
  }}
}}

void loop() {{
  if (!is_playing) {{
    return;
  }}
  if (is_stopped()) {{
    end_show(LSS_ActionHold);
    return;
  }}
  const uint32_t now_us = micros() - start_us;
  if (next_order < SHOW_ORDERS_COUNT) {{
    const ShowOrder order = order_at(next_order);
    if (now_us < order.due_us) {{
      return;
    }}
    if (order.is_led) {{
      LSS::genericWrite(order.id, LSS_ActionColorLED, order.value);
    }} else {{
      LSS::genericWrite(order.id, LSS_ActionMove, order.value, LSS_ActionParameterTime,
                        (int16_t)order.time_ms);
    }}
    ++next_order;
  }} else if (now_us >= SHOW_LEAD_US + SHOW_END_US) {{
    if (SHOW_PERIOD_US != 0) {{
      next_order = SHOW_FIRST_REPEATED;
      start_us += SHOW_PERIOD_US;
    }} else {{
      end_show(SHOW_END_ACTION);
    }}
  }}
}}
"""
