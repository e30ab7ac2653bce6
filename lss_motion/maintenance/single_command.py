"""What one command that a person types would do, and whether it may be sent unasked.

`judge` has no port: it is told where the servo stands. With a joint of a robot file, a move is
changed so that it keeps the speed of the joint, or refused where it would leave the range.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.protocol.codec import FAMILY_TABLES, language_table, read_command
from lss_motion.protocol.constants import BROADCAST_ID, Family
from lss_motion.protocol.framing import encode
from lss_motion.protocol.table import Form, Unit
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.codec import Decoded, Language
    from lss_motion.protocol.framing import Command
    from lss_motion.robot.model import Joint


class Consent(Enum):
    """What a command needs before it is sent."""

    NONE = "none"
    QUESTION = "question"
    """A person agrees, or `--yes` is given."""
    FORCE = "force"
    """`--force` as well: it leaves the limits of the robot file, or changes every servo."""


class CommandVerdict(Struct, frozen=True, kw_only=True):
    """The command as it would be sent, what it does, and what it needs.

    `notes` are sentences for people: what was changed, and why a question is asked.
    """

    command: Command
    text: str
    consent: Consent
    notes: tuple[str, ...] = ()


class Standing(Struct, frozen=True, kw_only=True):
    """What the servo of a joint has reported: None where it has not."""

    servo_deg: float | None = None
    has_profile: bool | None = None
    """True in EM1, where T and SD limit the speed of a move."""


HARMLESS: Final = frozenset({"H", "L", "LED"})
"""Actions that stop a servo or show a colour: sent unasked, to all servos too."""

TO_ANGLE: Final = frozenset({"D", "MD"})
TO_PULSE: Final = frozenset({"P", "M"})
ENDLESS: Final = frozenset({"WD", "WR", "RDM"})
"""The keywords that move a servo: to an angle, to a pulse width, without an end."""

MS: Final = s_from_ms(1)

ROUNDED_UNITS: Final = 0.5
"""A target may be this many wire units outside of the range: its rounding."""


def judge(
    command: Command,
    language: Family | Language,
    joint: Joint | None = None,
    standing: Standing | None = None,
) -> CommandVerdict:
    """Return what `command` does and needs; `joint` is the one of the robot file with that id."""
    meant = None if _repeats(command) else read_command(language, command)
    text = _text(command, meant)
    if meant is not None and meant.form is Form.QUERY:
        return CommandVerdict(command=command, text=text, consent=Consent.NONE)
    keyword = command.keyword
    if meant is not None and keyword in HARMLESS:
        return CommandVerdict(command=command, text=text, consent=Consent.NONE)
    if command.servo_id == BROADCAST_ID:
        note = "every servo on the bus would obey at once"
        return CommandVerdict(command=command, text=text, consent=Consent.FORCE, notes=(note,))
    if meant is None:
        consent = Consent.QUESTION if joint is None else Consent.FORCE
        family = language_table(language).family
        note = f"no document of {family} describes this command, so its effect is not known"
        return CommandVerdict(command=command, text=text, consent=consent, notes=(note,))
    if keyword in TO_ANGLE | TO_PULSE | ENDLESS:
        if joint is None:
            note = "no robot file gives the range and the speed of this servo"
            return CommandVerdict(
                command=command, text=text, consent=Consent.QUESTION, notes=(note,)
            )
        return _move(command, joint, standing or Standing())
    notes = [_lasts(meant, keyword)]
    if keyword == "RESET" and language_table(language).family is Family.LSS_PRO:
        notes.append("its port is gone for up to 10 s if the USB cable is at this servo")
    return CommandVerdict(command=command, text=text, consent=Consent.QUESTION, notes=tuple(notes))


def _repeats(command: Command) -> bool:
    """Return whether a modifier stands twice: which of them a servo obeys is not known."""
    names = [name for name, _ in command.modifiers]
    return len(names) != len(set(names))


def _lasts(meant: Decoded, keyword: str) -> str:
    if meant.form is Form.CONFIG:
        return "the servo stores it, and keeps it without power"
    if keyword in {"RESET", "RS"}:
        return "the servo restarts with its stored settings, limp until it is moved"
    if meant.row.queries:
        return "the servo keeps it until its power is off, and moves accordingly"
    return "the servo may be another one afterwards"


def _move(command: Command, joint: Joint, standing: Standing) -> CommandVerdict:
    """Return the verdict on a move of a joint of the robot file."""
    text = _text(command, read_command(joint.model.language, command))
    if command.keyword in TO_PULSE | ENDLESS:
        reason = (
            f"{command.keyword} turns joint {joint.name!r} without an end"
            if command.keyword in ENDLESS
            else f"the target of {command.keyword} cannot be compared with the range of joint "
            f"{joint.name!r}; use D"
        )
        return CommandVerdict(command=command, text=text, consent=Consent.FORCE, notes=(reason,))
    target_deg = _target_deg(command, joint, standing)
    if target_deg is None:
        note = f"joint {joint.name!r} does not report where it stands"
        return CommandVerdict(command=command, text=text, consent=Consent.QUESTION, notes=(note,))
    slack_deg = ROUNDED_UNITS * joint.unit_deg
    at_deg = joint.joint_deg(target_deg)
    if not joint.position_min_deg - slack_deg <= at_deg <= joint.position_max_deg + slack_deg:
        reason = (
            f"joint {joint.name!r} would go to {at_deg:g} deg, its range is "
            f"{joint.position_min_deg:g} to {joint.position_max_deg:g} deg"
        )
        return CommandVerdict(command=command, text=text, consent=Consent.FORCE, notes=(reason,))
    is_limited = joint.model.family is not Family.IO2 and standing.has_profile and not joint.unread
    if not is_limited or standing.servo_deg is None:
        note = (
            f"the speed of joint {joint.name!r} cannot be limited: it moves as fast as its "
            f"servo can"
        )
        return CommandVerdict(command=command, text=text, consent=Consent.QUESTION, notes=(note,))
    return _within_speed(command, joint, abs(target_deg - standing.servo_deg))


def _target_deg(command: Command, joint: Joint, standing: Standing) -> float | None:
    if not isinstance(command.value, int):
        return None
    given_deg = command.value / joint.model.wire_per_deg
    if command.keyword == "D":
        return given_deg
    return None if standing.servo_deg is None else standing.servo_deg + given_deg


def _within_speed(command: Command, joint: Joint, way_deg: float) -> CommandVerdict:
    """Return the move with T and SD such that the servo keeps the speed of its joint."""
    limit_deg_s = joint.speed_max_deg_s
    least_s = way_deg / limit_deg_s
    if joint.response.t_law == "exact":  # Its T includes the ramps.
        least_s += limit_deg_s / joint.accel_max_deg_s2
    least_ms = max(1, math.ceil(least_s / MS))
    most = math.floor(language_table(joint.model.language).modifiers["SD"].wire(limit_deg_s))
    given = dict(command.modifiers)
    kept = dict(given)
    if "T" in given or "SD" not in given:
        kept["T"] = max(given.get("T", 0), least_ms)
    if "SD" in given:
        kept["SD"] = min(given["SD"], most)
    changed = command._replace(modifiers=tuple(kept.items()))
    notes: tuple[str, ...] = ()
    if changed != command:
        was = "no T and no SD" if not {"T", "SD"} & given.keys() else "more speed"
        notes = (
            f"joint {joint.name!r} keeps {limit_deg_s:g} deg/s: the command had {was}, it is sent "
            f"as {encode(changed)[:-1].decode('ascii')}",
        )
    text = _text(changed, read_command(joint.model.language, changed))
    return CommandVerdict(command=changed, text=text, consent=Consent.NONE, notes=notes)


def _text(command: Command, meant: Decoded | None) -> str:
    """Return bytes and meaning: `#5D900T500: servo 5, position 90 deg, T 500 ms`."""
    line = encode(command)[:-1].decode("ascii", "replace")
    receiver = "every servo" if command.servo_id == BROADCAST_ID else f"servo {command.servo_id}"
    if meant is None:
        return f"{line}: {receiver}, {command.keyword}"
    words = [f"{receiver}, {meant.row.meaning}"]
    if meant.value is not None:
        words[0] += f" {_value(meant.value)}{_unit(meant.unit)}"
    table = FAMILY_TABLES[Family.LSS].modifiers
    words += [f"{name} {_value(v)}{_unit(table[name].unit)}" for name, v in meant.modifiers.items()]
    stored = " (stored)" if meant.form is Form.CONFIG else ""
    return f"{line}: {', '.join(words)}{stored}"


def _value(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _unit(unit: Unit) -> str:
    return f" {unit}" if unit else ""


def read_standing(joint: Joint, answers: Mapping[str, int | str | None]) -> Standing:
    """Return what the answers to `standing_queries` mean, by keyword."""
    position, mode = answers.get("QD"), answers.get("QEM")
    return Standing(
        servo_deg=position / joint.model.wire_per_deg if isinstance(position, int) else None,
        has_profile=None if mode is None else mode == 1,
    )


def standing_queries(joint: Joint) -> tuple[str, ...]:
    """Return the queries whose answers `judge` needs for a move of the joint."""
    return ("QD",) if joint.model.family is Family.IO2 else ("QD", "QEM")
