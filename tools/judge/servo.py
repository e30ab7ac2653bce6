"""What a servo makes of the bytes that it receives, by the maker's documents.

`Session` holds the settings that are in force, those that are stored, and where they came from: a
restarted servo has its stored ones, which are the factory's unless they were configured.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from judge.recording import IO2, PRO, TOP_SPEED_DEG_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from judge.recording import JointRow

BROADCAST: Final = 254
SECTION: Final = re.compile(r"#(\d+)([A-Z]+)(-?\d+)?((?:[A-Z]+-?\d+)*)$", re.IGNORECASE)
MODIFIER: Final = re.compile(r"([A-Z]+)(-?\d+)", re.IGNORECASE)
BOARD_CHARS: Final = 15
"""A 2IO board has a buffer of 16 bytes for a section, without a check of bounds; the last is NUL.
Every section on its bus goes through it."""
RPM_DEG_S: Final = 6.0
RAMP_STEP_DEG_S2: Final = {PRO: 0.01}
"""AA and AD of a PRO count in hundredths of a degree a second squared, as in the maker's code,
those of others in steps of 10 deg/s²."""
OTHER_RAMP_STEP_DEG_S2: Final = 10.0
FACTORY_RAMP_DEG_S2: Final = 1000.0
FACTORY_FILTER: Final = 5
SPEED_STEP_DEG_S: Final = {PRO: 0.01}
"""SD of a PRO in hundredths of a degree a second (the maker's code), of others in tenths."""
OTHER_SPEED_STEP_DEG_S: Final = 0.1
PULSE_MID_US, PULSE_HALF_US = 1500.0, 1000.0
FACTORY_RANGE: Final = 1800

MOVES: Final = frozenset({"D", "MD", "P", "M"})
WHEELS: Final = frozenset({"WD", "WR", "RDM"})
SESSION: Final = frozenset({"SD", "AA", "AD", "EM", "FPC", "G", "O", "AR"})
BOARD_SESSION: Final = frozenset({"G"})
"""The pins of a 2IO have no other of these settings; the board has no `O`."""


@dataclass(frozen=True)
class Section:
    """One command for one servo: `#5D100T50SD1800` has keyword D and two modifiers."""

    servo_id: int
    keyword: str
    value: int | None
    modifiers: Mapping[str, int]
    text: str

    def is_for(self, servo_id: int) -> bool:
        """Return whether a servo with that id obeys it."""
        return self.servo_id in (servo_id, BROADCAST)

    @property
    def is_query(self) -> bool:
        """Whether it asks; a query changes nothing."""
        return self.keyword.startswith("Q")


@lru_cache(maxsize=1 << 14)
def sections_of(line: str) -> tuple[Section, ...]:
    """Return the commands of a line; a `#` begins another. What cannot be read is left out."""
    return tuple(_sections(line))


def _sections(line: str) -> Iterator[Section]:
    for part in line.rstrip("\r").split("#")[1:]:
        found = SECTION.match("#" + part)
        if found is not None:
            value = None if found[3] is None else int(found[3])
            modifiers = {name.upper(): int(n) for name, n in MODIFIER.findall(found[4])}
            yield Section(int(found[1]), found[2].upper(), value, modifiers, "#" + part)


@dataclass(frozen=True)
class Move:
    """A command that moves a servo, with the settings that were in force when it arrived.

    `shaft_deg` is its target from the factory zero; None: it turns without end. `cap_deg_s` is the
    highest speed that SD allows it; `has_profile`: EM1, in which T and SD count. `restarted_s` is
    the last restart of the servo before it. `filed_deg` is the target in the gyre and origin of the
    robot file.
    """

    at_s: float
    text: str
    shaft_deg: float | None
    duration_s: float | None
    cap_deg_s: float
    accel_deg_s2: float
    has_profile: bool
    filter_count: int
    restarted_s: float | None
    is_frame_right: bool
    filed_deg: float | None
    written_s: float = 0.0
    """When the host wrote it; it may have waited in an adapter or on the line."""


class Session:
    """The settings of one servo."""

    def __init__(self, joint: JointRow, stored: Mapping[str, int]) -> None:
        self.joint = joint
        self._degree = 0.01 if joint.family == PRO else 0.1
        self._speed_deg_s = SPEED_STEP_DEG_S.get(joint.family, OTHER_SPEED_STEP_DEG_S)
        self._ramp_deg_s2 = RAMP_STEP_DEG_S2.get(joint.family, OTHER_RAMP_STEP_DEG_S2)
        factory_ramp = round(FACTORY_RAMP_DEG_S2 / self._ramp_deg_s2)
        top_deg_s = TOP_SPEED_DEG_S.get(joint.model, math.inf)
        self._top_deg_s = top_deg_s
        self._factory = {
            "SD": round(top_deg_s / self._speed_deg_s) if math.isfinite(top_deg_s) else 10**6,
            "AA": factory_ramp,
            "AD": factory_ramp,
            "EM": 1,
            "FPC": FACTORY_FILTER,
            "G": 1,
            "O": 0,
            "AR": FACTORY_RANGE,
        }
        self.stored = {**self._factory, **stored}
        self.session = dict(self.stored)
        self.restarted_s: float | None = None
        self.rest: str = "limp"
        """What the last motion command was: `limp`, `hold`, `move` or `wheel`."""

    def restart(self, at_s: float) -> None:
        """Take the stored settings, and be limp."""
        self.session = dict(self.stored)
        self.restarted_s = at_s
        self.rest = "limp"

    def change(self, settings: Mapping[str, int]) -> None:
        """Take settings that came from something else, for now and for every later start."""
        self.stored.update(settings)
        self.session.update(settings)

    def obey(self, section: Section, at_s: float, shaft_deg: float | None) -> Move | None:
        """Take one command; return the move that it is. `shaft_deg`: where the horn is."""
        word = section.keyword
        if section.is_query:
            return None
        if word in {"RESET", "RS"}:
            self.restart(at_s)
        elif word == "L":
            self.rest = "limp"
        elif word == "H" and self.joint.family != IO2:
            self.rest = "hold"
        elif word in MOVES and section.value is not None:
            self.rest = "move"
            return self._move(section, at_s, self._target_deg(section, shaft_deg))
        elif word in WHEELS and section.value is not None:
            self.rest = "wheel" if section.value else "hold"
            return self._move(section, at_s, None)
        else:
            self._set(section)
        return None

    def _set(self, section: Section) -> None:
        word, value = section.keyword, section.value
        if value is None:
            return
        known = BOARD_SESSION if self.joint.family == IO2 else SESSION | {"SR"}
        is_config = word.startswith("C") and word[1:] in known
        name = word[1:] if is_config else word
        if name not in known:
            return
        if name == "SR":
            name, value = "SD", round(value * RPM_DEG_S / self._speed_deg_s)
        if name == "SD":
            value = min(value, self._factory["SD"])
        self.session[name] = value
        if is_config:
            self.stored[name] = value

    def _target_deg(self, section: Section, shaft_deg: float | None) -> float:
        """Return the target of a position command from the factory zero, clockwise."""
        assert section.value is not None
        value = float(section.value)
        per_us = self.session["AR"] * 0.1 / (2.0 * PULSE_HALF_US)
        if section.keyword == "P":
            pulse = min(max(value, PULSE_MID_US - PULSE_HALF_US), PULSE_MID_US + PULSE_HALF_US)
            return self._shaft_deg((pulse - PULSE_MID_US) * per_us)
        if section.keyword == "D":
            return self._shaft_deg(value * self._degree)
        away_deg = value * (self._degree if section.keyword == "MD" else per_us)
        return (shaft_deg or 0.0) + self._gyre * away_deg

    @property
    def _gyre(self) -> int:
        return self.session["G"] or 1

    def _shaft_deg(self, seen_deg: float) -> float:
        """Return the shaft angle of an angle in the servo's own frame of gyre and origin."""
        return self._gyre * seen_deg + self.session["O"] * 0.1

    def _move(self, section: Section, at_s: float, shaft_deg: float | None) -> Move:
        joint, speeds = self.joint, section.modifiers
        cap_deg_s = min(max(abs(self.session["SD"]), 1) * self._speed_deg_s, self._top_deg_s)
        if "SD" in speeds:
            cap_deg_s = min(cap_deg_s, speeds["SD"] * self._speed_deg_s)
        ramps = max(abs(self.session["AA"]), abs(self.session["AD"]), 1)
        is_right = self._gyre == joint.gyre and (
            abs(self.session["O"] * 0.1 - joint.origin_deg) < self._degree
        )
        return Move(
            at_s=at_s,
            text=section.text,
            shaft_deg=shaft_deg,
            duration_s=speeds["T"] / 1000.0 if speeds.get("T") else None,
            cap_deg_s=cap_deg_s,
            accel_deg_s2=ramps * self._ramp_deg_s2,
            has_profile=self.session["EM"] != 0,
            filter_count=max(self.session["FPC"], 1),
            restarted_s=self.restarted_s,
            is_frame_right=is_right or joint.family == IO2,
            filed_deg=None
            if shaft_deg is None
            else joint.gyre * (shaft_deg - self.session["O"] * 0.1) / self._gyre + joint.origin_deg,
        )
