"""How a simulated robot differs from what is assumed of it: `lss-play --virtual --sim`.

    deviation = read_deviation("lag=+30ms,droop=3deg", robot)
    perform(program, robot, is_virtual=True, deviation=deviation)

A deviation is a text of `key=value`, or a YAML file with the same keys, in which `joints:` gives
single joints another load, play or motor. `WORDS` lists the keys. Nothing of it is known to the
player: it changes only how the simulated servos and their line are made.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Lines, Physics
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.files.source import Location
    from lss_motion.robot.model import Robot


class Deviation(Struct, frozen=True, kw_only=True):
    """Differences from the simulator's defaults (`physics`); the defaults here are none."""

    lag_s: float = 0.0
    dead_s: float = 0.0
    ramp_ratio: float = 1.0
    retarget: Literal["keep_speed", "from_rest"] = "keep_speed"
    lines: Lines = "strict"
    t_law: Literal["cruise", "exact"] = "cruise"
    t_ignored_s: float = 0.0
    t_least_s: float = 0.0
    t_step_s: float = 0.0
    motor_ratio: float = 1.0
    droop_deg: float = 0.0
    backlash_deg: float = 0.0
    noise_deg: float | None = None
    usb_s: float = 0.0
    lost_ratio: float = 0.0
    corrupt_ratio: float = 0.0
    push_deg: float = 0.0
    push_at_s: float = 5.0
    push_for_s: float = 0.5
    joints: Mapping[str, Deviation] = field(default_factory=dict)
    """Of single joints: only `OWN` of these count."""

    def physics(self) -> Physics:
        """Return the physics of every bus."""
        usual = Physics()
        noise_deg = usual.noise_deg if self.noise_deg is None else self.noise_deg
        return replace(
            usual,
            lag_s=max(usual.lag_s + self.lag_s, LAG_LEAST_S),
            dead_s=self.dead_s,
            ramp_ratio=self.ramp_ratio,
            retarget=self.retarget,
            lines=self.lines,
            t_law=self.t_law,
            t_ignored_s=self.t_ignored_s,
            t_least_s=self.t_least_s,
            t_step_s=self.t_step_s,
            noise_deg=noise_deg,
        )

    def faults(self, robot: Robot) -> list[Fault]:
        """Return what the line and the motors lack, as faults from power-up on."""
        found = []
        if self.lost_ratio:
            found.append(Fault(kind=FaultKind.LOST_COMMAND, ratio=self.lost_ratio))
        if self.corrupt_ratio:
            found.append(Fault(kind=FaultKind.CORRUPT_REPLY, ratio=self.corrupt_ratio))
        for name, joint in robot.joints.items():
            own = self.joints.get(name, self)
            if own.motor_ratio < 1.0:
                weak = Fault(
                    kind=FaultKind.WEAK,
                    servo_id=joint.servo_id,
                    bus=joint.bus,
                    speed_ratio=own.motor_ratio,
                )
                found.append(weak)
        return found

    def bus_options(self, robot: Robot) -> dict[str, Any]:
        """Return the arguments of `bus_from_robot`, besides the faults."""
        from lss_motion.sim.hand import Push

        own = {name: self.joints.get(name, self) for name in robot.joints}
        push = Push(self.push_at_s, self.push_at_s + self.push_for_s, self.push_deg)
        return {
            "physics": self.physics(),
            "usb_latency_ns": ns_from_s(self.usb_s),
            "droop_deg": {name: one.droop_deg for name, one in own.items()},
            "backlash_deg": {name: one.backlash_deg for name, one in own.items()},
            "pushes": dict.fromkeys(robot.joints, push) if self.push_deg else {},
        }


OWN: Final = ("droop", "backlash", "motor")
"""Keys that single joints may have."""

LAG_LEAST_S: Final = 0.001
"""A horn that follows its profile at once cannot be simulated."""


class Word(NamedTuple):
    """A key: the field that it sets, its unit (empty: a word), its bounds, and its meaning."""

    field: str
    unit: Literal["s", "deg", "ratio", ""]
    least: float
    most: float
    meaning: str

    @property
    def bounds(self) -> str:
        """Return what is allowed, as it is typed: `-0.02s to 0.5s`."""
        unit = "" if self.unit == "ratio" else self.unit
        return f"{self.least:g}{unit} to {self.most:g}{unit}"


WORDS: Final[dict[str, Word]] = {
    "lag": Word("lag_s", "s", -0.02, 0.5, "added to the horn's lag of 20 ms, such as +30ms"),
    "dead": Word("dead_s", "s", 0.0, 0.5, "a command takes effect so much later"),
    "ramp": Word("ramp_ratio", "ratio", 0.02, 10.0, "ramps are so many times AA and AD"),
    "retarget": Word("retarget", "", 0, 0, "keep_speed, or from_rest: a new move begins at rest"),
    "lines": Word("lines", "", 0, 0, "strict, or lenient: undocumented lines as they seem meant"),
    "t_law": Word("t_law", "", 0, 0, "cruise, or exact: T holds for the whole move"),
    "t_ignored": Word("t_ignored_s", "s", 0.0, 10.0, "a shorter T is ignored"),
    "t_least": Word("t_least_s", "s", 0.0, 10.0, "a shorter T is taken as this one"),
    "t_step": Word("t_step_s", "s", 0.0, 1.0, "T is rounded to multiples of this"),
    "motor": Word("motor_ratio", "ratio", 0.01, 1.0, "share of the top speed that is left"),
    "droop": Word("droop_deg", "deg", -30.0, 30.0, "how far a load pulls a level arm down"),
    "backlash": Word("backlash_deg", "deg", 0.0, 20.0, "play of the gears"),
    "noise": Word("noise_deg", "deg", 0.0, 10.0, "readings scatter by so much to either side"),
    "usb": Word("usb_s", "s", 0.0, 0.255, "the adapter delivers replies this often"),
    "lost": Word("lost_ratio", "ratio", 0.0, 1.0, "share of commands that reach no servo"),
    "corrupt": Word("corrupt_ratio", "ratio", 0.0, 1.0, "share of replies with a wrong byte"),
    "push": Word("push_deg", "deg", -30.0, 30.0, "a hand pushes all horns so far"),
    "push_at": Word("push_at_s", "s", 0.0, 86_400.0, "when it pushes, from power-up (5s)"),
    "push_for": Word("push_for_s", "s", 0.01, 86_400.0, "how long (500ms)"),
}

_KEYS: Final = f"keys are {', '.join(WORDS)}"
_CHOICES: Final = {
    "retarget": ("keep_speed", "from_rest"),
    "t_law": ("cruise", "exact"),
    "lines": ("strict", "lenient"),
}
_SCALES: Final = {
    "s": {"s": 1.0, "ms": 1e-3},
    "deg": {"deg": 1.0, "": 1.0},
    "ratio": {"": 1.0, "%": 0.01, "x": 1.0},
}
_NUMBER: Final = re.compile(r"([-+]?\d+(?:\.\d*)?|[-+]?\.\d+)\s*(ms|s|deg|%|x|)")


def read_deviation(text: str, robot: Robot) -> Deviation:
    """Return the deviation that a text of `key=value` or a file gives; `InputError` if neither."""
    if "=" in text:
        return deviation_from_text(text)
    if not text or not Path(text).exists():
        raise InputError(f"{text!r:.60} is neither key=value nor an existing file; {_KEYS}")
    return _from_file(Path(text), robot)


def deviation_from_text(text: str) -> Deviation:
    """Return the deviation of a text such as `lag=+30ms,droop=3deg`."""
    values: dict[str, object] = {}
    for part in filter(None, map(str.strip, text.split(","))):
        key, equals, value = part.partition("=")
        if not equals:
            raise InputError(f"{part!r:.60} is not key=value; {_KEYS}")
        if key.strip() in values:
            raise InputError(f"{key.strip()} is given twice")
        values[key.strip()] = value.strip()
    for _, problem in (found := _Read(values)).problems:
        raise InputError(problem)
    return found.deviation


class _Read:
    """A mapping of keys to values as a deviation, with all that is wrong with it."""

    def __init__(self, values: Mapping[str, object], allowed: tuple[str, ...] = ()) -> None:
        self.problems: list[tuple[str, str]] = []
        made: dict[str, Any] = {}
        for key, value in values.items():
            known = allowed or tuple(WORDS)
            if key not in known:
                self.problems.append(
                    (key, f"{key!r:.60} is no key here; {known_names(key, known)}")
                )
                continue
            if key in ("push_at", "push_for") and "push" not in values:
                self.problems.append(
                    (key, f"{key} alone pushes nothing; give push, too: push=6deg")
                )
            try:
                made[WORDS[key].field] = _value(key, str(value))
            except ValueError as error:
                self.problems.append((key, str(error)))
        self.deviation = Deviation(**made)


def _value(key: str, text: str) -> float | str:
    """Return the value of a key; ValueError says what is allowed."""
    word = WORDS[key]
    if not word.unit:
        if text not in _CHOICES[key]:
            raise ValueError(f"{key} is {text!r:.60}: {known_names(text, _CHOICES[key])}")
        return text
    found, scales = _NUMBER.fullmatch(text), _SCALES[word.unit]
    if found is None or (found[2] not in scales and float(found[1]) != 0.0):
        units = " or ".join(unit for unit in scales if unit) or "no unit"
        raise ValueError(f"{key} is {text!r:.60}: it needs a number with {units}")
    number = float(found[1]) * scales.get(found[2], 1.0)
    if not word.least <= number <= word.most:
        raise ValueError(f"{key} is {text}: allowed is {word.bounds}")
    return number


def _from_file(path: Path, robot: Robot) -> Deviation:
    from lss_motion.files.yaml_source import Mistake, read_yaml

    source = read_yaml(path)
    content, problems = source.value, [*source.problems]
    if not content:
        problems.append(Mistake((), f"holds no keys; {_KEYS}"))
    own = content.get("joints", {})
    shared = _Read({key: value for key, value in content.items() if key != "joints"})
    problems += [Mistake((key,), text) for key, text in shared.problems]
    joints = {}
    for name, values in own.items() if isinstance(own, dict) else []:
        place: Location = ("joints", name)
        if name not in robot.joints:
            known = known_names(name, robot.joints)
            problems.append(
                Mistake(place, f"robot {robot.name!r} has no joint {name!r:.60}; {known}")
            )
        elif not isinstance(values, dict):
            problems.append(Mistake(place, f"{name!r:.60} needs a mapping of {', '.join(OWN)}"))
        else:
            read = _Read(values, OWN)
            problems += [Mistake((*place, key), text) for key, text in read.problems]
            joints[name] = _over(shared.deviation, read.deviation, values)
    if not isinstance(own, dict):
        problems.append(Mistake(("joints",), "'joints' needs a mapping by joint"))
    if problems:
        raise source.error(problems)
    return replace(shared.deviation, joints=joints)


def _over(shared: Deviation, own: Deviation, given: Mapping[str, object]) -> Deviation:
    """Return `shared` with the fields of `own` that are `given`."""
    names = [WORDS[key].field for key in given if key in WORDS]
    return replace(shared, **{name: getattr(own, name) for name in names})


def words_text() -> str:
    """Return the table of keys, a line each."""
    return "\n".join(
        f"  {key:10} {word.meaning}{f'; {word.bounds}' if word.unit else ''}"
        for key, word in WORDS.items()
    )


def deviation_text(deviation: Deviation) -> str:
    """Return a deviation as the text that `deviation_from_text` reads; without single joints."""
    return ",".join(_words_of(deviation)) or "as assumed"


def _words_of(deviation: Deviation) -> Iterator[str]:
    usual = Deviation()
    for key, word in WORDS.items():
        value = getattr(deviation, word.field)
        if value == getattr(usual, word.field):
            continue
        if word.unit == "s":
            sign = "+" if key == "lag" and value > 0.0 else ""
            yield f"{key}={sign}{1e3 * value:g}ms"
        elif word.unit == "deg":
            yield f"{key}={value:g}deg"
        else:
            yield f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
