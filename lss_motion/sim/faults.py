"""Faults of a simulated bus: rows with a time, a servo and a kind, repeatable from a seed.

`Drift` converts between the instants of the host and those of the servos, whose clocks drift.
`SleepyClock` is the virtual clock of a host that wakes late. `load_faults` reads the rows of a
file, with the checks that all authors' files get.
"""

from __future__ import annotations

import heapq
import math
from enum import StrEnum
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Annotated, Literal, Self

from msgspec import Struct, field

from lss_motion.errors import ProtocolError
from lss_motion.files.keys import FILE_VERSION, VERSION, Field, FileModel, Version
from lss_motion.files.texts import known_names
from lss_motion.protocol.codec import language_table, stored_wire
from lss_motion.protocol.constants import RESET_S, Family
from lss_motion.protocol.io2 import PIN_IDS
from lss_motion.sim.boards import RAW_MAX, SENSORS
from lss_motion.system.clock import VirtualClock
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.files.yaml_source import Mistake
    from lss_motion.protocol.codec import Language
    from lss_motion.robot.model import Robot


class FaultKind(StrEnum):
    """Kinds of faults.

    Each with what it concerns, when it acts, what it means, and its keys in a faults file: those
    that it needs, and with `?` those that it may have. `line` is the line and the host. `each`: at
    every line, reply or wait in its time, or at a `ratio` of them; `once`: at `at_s`; `span`: it
    begins and ends; `steady`: all its time.
    """

    def __new__(
        cls, word: str, concerns: str = "", acts: str = "", meaning: str = "", keys: str = ""
    ) -> Self:
        """Make a member from its row."""
        self = str.__new__(cls, word)
        self._value_ = word
        self.concerns, self.acts, self.meaning = concerns, acts, meaning
        self.needs = tuple(key for key in keys.split() if not key.endswith("?"))
        self.may = tuple(key.rstrip("?") for key in keys.split())
        return self

    concerns: str
    acts: str
    meaning: str
    needs: tuple[str, ...]
    may: tuple[str, ...]

    # fmt: off
    LOST_COMMAND = "lost_command", "command", "each", "a line of the host reaches no servo"
    CORRUPT_COMMAND = ("corrupt_command", "command", "each",
        "one byte of a line of the host is another")
    SHORT_COMMAND = "short_command", "command", "each", "one byte of a line of the host is missing"
    DOUBLE_COMMAND = "double_command", "command", "each", "a line of the host is received twice"
    MERGED_COMMAND = ("merged_command", "command", "each",
        "the CR of a line of the host is lost: it runs into the next")
    LOST_REPLY = "lost_reply", "reply", "each", "a reply is not sent"
    CORRUPT_REPLY = "corrupt_reply", "reply", "each", "one byte of a reply is another"
    SHORT_REPLY = "short_reply", "reply", "each", "one byte of a reply is missing"
    DOUBLE_REPLY = "double_reply", "reply", "each", "a reply is sent twice"
    MERGED_REPLY = ("merged_reply", "reply", "each",
        "the CR of a reply is lost: it runs into the next")
    LATE_REPLY = "late_reply", "reply", "each", "a reply comes `late_s` later", "late_s"
    SPLIT_REPLY = ("split_reply", "reply", "each",
        "the second half of a reply comes `late_s` later", "late_s")
    CLOGGED = "clogged", "line", "steady", "what the host writes waits until `until_s`", "until_s"
    BLOCKED_PORT = "blocked_port", "line", "steady", "the port takes no bytes of the host"
    UNPLUGGED = "unplugged", "line", "steady", "the port is gone; what was on its way is lost"
    OVERSLEEP = ("oversleep", "line", "each",
        "the host wakes `late_s` too late (virtual time only)", "late_s")
    CLOCK_DRIFT = ("clock_drift", "line", "steady",
        "the servos' time runs `drift_ppm` faster than the host's", "drift_ppm")
    DEAF = "deaf", "servo", "each", "a servo does not receive a line"
    WRONG_ID = "wrong_id", "servo", "each", "a servo answers as `as_id`", "servo as_id"
    RESET = ("reset", "servo", "once",
        "a servo restarts: it is deaf for `deaf_s`, then limp, without its settings", "deaf_s?")
    STUCK = "stuck", "servo", "span", "a horn does not turn"
    WEAK = "weak", "servo", "span", "a motor has only `speed_ratio` of its top speed", "speed_ratio"
    HOT = "hot", "servo", "once", "a servo has `temperature_c` at once", "temperature_c"
    INPUT = ("input", "servo", "once",
        "an analog input of an LSS-2IO takes a value", "servo raw? distance_mm? sensor?")
    STORED = ("stored", "servo", "once",
        "the `settings` of a servo are these at once, stored ones as well", "settings")
    FACTORY = ("factory", "servo", "once",
        "a servo restarts with the settings of the factory, but for its id and rate", "deaf_s?")
    EXCHANGED = ("exchanged", "servo", "once",
        "another servo, with the same id, takes the place of one; see `factory`",
        "deaf_s? settings?")
    TWIN = ("twin", "servo", "steady",
        "another servo with the same id is on the bus, from power-up", "servo")
    LOW_VOLTAGE = ("low_voltage", "line", "span",
        "the supply of the bus gives only `supply_v`", "supply_v")
    WRONG_SCALE = ("wrong_scale", "servo", "once",
        "one unit of `setting` is `scale_ratio` times that of the documents", "setting scale_ratio")
    SECOND_MASTER = ("second_master", "line", "steady",
        "another host sends `text` every `every_s`; its replies arrive, too", "text every_s")
    ECHO = ("echo", "line", "steady",
        "the adapter returns what the host sends, besides the replies")
    # fmt: on

    def has(self, key: str) -> bool:
        """Return whether a key of a faults file says something about this kind."""
        match key:
            case "kind" | "servo" | "bus":
                return True
            case "at_s" | "until_s":
                return self is not FaultKind.TWIN
            case "ratio":
                return self.acts == "each"
        return key in self.may


RESTARTING = frozenset({FaultKind.RESET, FaultKind.FACTORY, FaultKind.EXCHANGED})
"""With these a servo restarts."""
INSTANT = frozenset(kind for kind in FaultKind if kind.acts == "once")
ABOUT_LINE = frozenset(kind for kind in FaultKind if kind.concerns in ("command", "line"))
"""These concern the line or the host. A servo that does not receive commands is `deaf`."""
STEADY = frozenset(kind for kind in FaultKind if kind.acts != "each")
"""These have no `ratio`: they apply all the time."""
REPLY_KINDS = tuple(kind for kind in FaultKind if kind.concerns == "reply")
"""These damage replies; no servo is affected."""

SCALED = ("D", "SD", "AA", "AD", "T")
"""Values whose scale may be another one: D and SD with everything in their units."""

FOREVER_NS = 2**62
"""The end of a fault without an end: 146 years."""


class Fault(Struct, frozen=True, kw_only=True):
    """One row. Times count from power-up, in the servos' time.

    `servo_id`       id of the servo; None: all servos, or the line
    `bus`            name of the bus; None: all
    `ratio`          share of the lines, replies or waits in its time; 1: all
    `late_s`         for `late_reply`, `split_reply`, `oversleep`
    `as_id`          for `wrong_id`: the id that stands in the replies
    `speed_ratio`    for `weak`: what is left of the top speed
    `temperature_c`  for `hot`
    `drift_ppm`      for `clock_drift`: millionths by which the servos' time runs faster
    `raw`            for `input`: the value of the converter, 0 to 1023
    `deaf_s`         for `reset`, `factory`, `exchanged`: how long the servo receives nothing, less
                     after a dip of its supply; a board of an LSS-2IO has a time of its own
    `settings`       for `stored`: wire values by the name of the setting, such as `{"G": -1}`; ID
                     acts at once, too. `servo_id` is then the id with which the servo was set up.
                     For `exchanged`: those of the other servo that are not the factory's
    `supply_v`       for `low_voltage`: what the supply gives without load
    `setting`        for `wrong_scale`: one of `SCALED`; the servo takes and answers it so, from
                     then on
    `scale_ratio`    for `wrong_scale`
    `text`           for `second_master`: one line, without its CR
    `every_s`        for `second_master`
    """

    kind: FaultKind
    at_s: float = 0.0
    until_s: float = math.inf
    servo_id: int | None = None
    bus: str | None = None
    ratio: float = 1.0
    late_s: float = 0.0
    as_id: int = 0
    speed_ratio: float = 1.0
    temperature_c: float = 0.0
    drift_ppm: float = 0.0
    raw: int = 0
    deaf_s: float = RESET_S
    settings: Mapping[str, int] = field(default_factory=dict)
    supply_v: float = 0.0
    setting: str = ""
    scale_ratio: float = 1.0
    text: str = ""
    every_s: float = 1.0

    def __post_init__(self) -> None:
        if self.kind is FaultKind.CLOGGED and math.isinf(self.until_s):
            raise ValueError("a line that is clogged for ever is `unplugged`; give until_s")

    def strikes(self, random: Random) -> bool:
        """Return whether it applies to one line, reply or wait in its time."""
        return self.ratio >= 1.0 or random.random() < self.ratio

    def span_ns(self, origin_ns: int) -> tuple[int, int]:
        """Return when it begins and ends."""
        is_endless = math.isinf(self.until_s)
        until_ns = FOREVER_NS if is_endless else origin_ns + ns_from_s(self.until_s)
        return origin_ns + ns_from_s(self.at_s), until_ns


class FaultEdge(Struct, frozen=True):
    """An instant at which a fault of a servo begins or ends."""

    due_ns: int
    fault: Fault
    is_begin: bool


class Faults:
    """Applies the rows. One random number is drawn for each line or reply, in their order.

    A method that applies rows need not be called where there are none of its rows, which are
    `about_lines`, `about_replies`, `deafness` and `wrong_ids`.
    """

    def __init__(self, faults: Iterable[Fault], random: Random) -> None:
        self._faults = tuple(faults)
        self.about_lines = self._of(*(kind for kind in FaultKind if kind.concerns == "command"))
        self.about_replies = self._of(*REPLY_KINDS)
        self.deafness = self._of(FaultKind.DEAF)
        self.wrong_ids = self._of(FaultKind.WRONG_ID)
        self._random = random
        self._origin_ns = 0
        self.turns: list[FaultEdge] = []
        """When a fault of a servo still begins or ends, the next one last."""
        self._unfinished = b""

    def start(self, now_ns: int) -> None:
        """Count time from `now_ns`."""
        self._origin_ns = now_ns
        for fault in self._faults:
            if fault.kind.acts in ("once", "span"):
                from_ns, until_ns = fault.span_ns(now_ns)
                self.turns.append(FaultEdge(from_ns, fault, is_begin=True))
                if fault.kind.acts == "span" and until_ns < FOREVER_NS:
                    self.turns.append(FaultEdge(until_ns, fault, is_begin=False))
        self.turns.sort(key=lambda turn: turn.due_ns, reverse=True)

    def spans_ns(self, kind: FaultKind) -> list[tuple[int, int]]:
        """Return when rows of a kind begin and end, in order of time."""
        return sorted(f.span_ns(self._origin_ns) for f in self._faults if f.kind is kind)

    def received(self, line: bytes, now_ns: int) -> list[bytes]:
        """Return the lines that reach the servos in place of one: none, one or two."""
        count = 1
        for fault in self._active(self.about_lines, now_ns, None):
            match fault.kind:
                case FaultKind.LOST_COMMAND if fault.strikes(self._random):
                    return []
                case FaultKind.CORRUPT_COMMAND if fault.strikes(self._random):
                    line = damaged(line[:-1], self._random) + line[-1:]
                case FaultKind.SHORT_COMMAND if fault.strikes(self._random):
                    line = shortened(line[:-1], self._random) + line[-1:]
                case FaultKind.DOUBLE_COMMAND if fault.strikes(self._random):
                    count = 2
                case FaultKind.MERGED_COMMAND if fault.strikes(self._random):
                    self._unfinished += line[:-1]
                    return []
                case _:
                    pass
        lines = [self._unfinished + line] + [line] * (count - 1)
        self._unfinished = b""
        return lines

    def is_deaf(self, servo_id: int, now_ns: int) -> bool:
        active = self._active(self.deafness, now_ns, servo_id)
        return any(fault.strikes(self._random) for fault in active)

    def sender(self, servo_id: int, now_ns: int) -> int:
        """Return the id that a servo puts into its reply."""
        for fault in self._active(self.wrong_ids, now_ns, servo_id):
            if fault.strikes(self._random):
                return fault.as_id
        return servo_id

    def sent(self, servo_id: int, data: bytes, start_ns: int) -> list[tuple[bytes, int]]:
        """Return what a servo sends instead of one reply, and when each piece is due.

        A piece begins when it is due and the one before it has ended.
        """
        count, split_ns = 1, 0
        for fault in self._active(self.about_replies, start_ns, servo_id):
            match fault.kind:
                case FaultKind.LOST_REPLY if fault.strikes(self._random):
                    return []
                case FaultKind.CORRUPT_REPLY if fault.strikes(self._random):
                    data = damaged(data, self._random)
                case FaultKind.SHORT_REPLY if fault.strikes(self._random):
                    data = shortened(data, self._random)
                case FaultKind.MERGED_REPLY if fault.strikes(self._random):
                    data = data.removesuffix(b"\r")
                case FaultKind.LATE_REPLY if fault.strikes(self._random):
                    start_ns += ns_from_s(fault.late_s)
                case FaultKind.SPLIT_REPLY if fault.strikes(self._random):
                    split_ns = ns_from_s(fault.late_s)
                case FaultKind.DOUBLE_REPLY if fault.strikes(self._random):
                    count = 2
                case _:
                    pass
        if split_ns:
            middle = len(data) // 2
            pieces = [(data[:middle], start_ns), (data[middle:], start_ns + split_ns)]
        else:
            pieces = [(data, start_ns)]
        return pieces * count

    def _of(self, *kinds: FaultKind) -> tuple[Fault, ...]:
        return tuple(fault for fault in self._faults if fault.kind in kinds)

    def _active(
        self, faults: Sequence[Fault], now_ns: int, servo_id: int | None
    ) -> Sequence[Fault]:
        now_s = s_from_ns(now_ns - self._origin_ns)
        return [
            fault
            for fault in faults
            if fault.at_s <= now_s < fault.until_s and fault.servo_id in (None, servo_id)
        ]


class SecondMaster:
    """The lines that another host sends, from rows of `second_master`.

    Assumed: both hosts' lines arrive whole, one after the other. `corrupt_command` has those that
    damage each other.
    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._rows = [fault for fault in faults if fault.kind is FaultKind.SECOND_MASTER]
        self._due: list[tuple[int, int, int]] = []

        self.due_ns = FOREVER_NS
        """When its next line arrives at the servos; `FOREVER_NS`: it sends no more."""

    def start(self, now_ns: int) -> None:
        """Count time from `now_ns`."""
        for index, fault in enumerate(self._rows):
            from_ns, until_ns = fault.span_ns(now_ns)
            heapq.heappush(self._due, (from_ns, index, until_ns))
            self.due_ns = self._due[0][0]

    def pop(self) -> tuple[int, bytes]:
        """Return its next line, CR included, and when it arrives."""
        now_ns, index, until_ns = heapq.heappop(self._due)
        again_ns = now_ns + max(ns_from_s(self._rows[index].every_s), 1)
        if again_ns < until_ns:
            heapq.heappush(self._due, (again_ns, index, until_ns))
        self.due_ns = self._due[0][0] if self._due else FOREVER_NS
        return now_ns, self._rows[index].text.encode("latin-1") + b"\r"


def damaged(data: bytes, random: Random) -> bytes:
    """Return the bytes with one of them replaced by another."""
    if not data:
        return data
    place = random.randrange(len(data))
    other = (data[place] + random.randrange(1, 256)) % 256
    return data[:place] + bytes([other]) + data[place + 1 :]


def shortened(data: bytes, random: Random) -> bytes:
    """Return the bytes without one of them."""
    if not data:
        return data
    place = random.randrange(len(data))
    return data[:place] + data[place + 1 :]


PPM = 1_000_000


class Drift:
    """Converts instants as rows of `clock_drift` say. Both clocks agree at power-up."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._faults = tuple(faults)
        self._spans: list[tuple[int, int, int]] = []
        self.is_there = bool(self._faults)
        """Whether the two clocks ever differ."""

    def start(self, now_ns: int) -> None:
        self._spans = [(*fault.span_ns(now_ns), round(fault.drift_ppm)) for fault in self._faults]

    def bus_ns(self, host_ns: int) -> int:
        """Return the servos' instant; later for a later host instant."""
        ahead_ns = 0
        for from_ns, until_ns, drift_ppm in self._spans:
            passed_ns = min(host_ns, until_ns) - from_ns
            if passed_ns > 0:
                ahead_ns += passed_ns * drift_ppm // PPM
        return host_ns + ahead_ns

    def host_ns(self, bus_ns: int) -> int:
        """Return the first instant of the host at which the servos' is `bus_ns`."""
        if not self._spans:
            return bus_ns
        near_ns = bus_ns - (self.bus_ns(bus_ns) - bus_ns)
        away_ns = 1
        while not self.bus_ns(near_ns - away_ns) < bus_ns <= self.bus_ns(near_ns + away_ns):
            away_ns *= 2
        low_ns, high_ns = near_ns - away_ns, near_ns + away_ns
        while low_ns < high_ns:
            middle_ns = (low_ns + high_ns) // 2
            if self.bus_ns(middle_ns) < bus_ns:
                low_ns = middle_ns + 1
            else:
                high_ns = middle_ns
        return low_ns


class SleepyClock(VirtualClock):
    """Virtual time in which rows of `oversleep` make a wait end `late_s` after its instant."""

    def __init__(self, faults: Iterable[Fault], *, seed: int) -> None:
        super().__init__()
        self._faults = [fault for fault in faults if fault.kind is FaultKind.OVERSLEEP]
        self._random = Random(f"{seed}/host")

    def advance_to(self, instant_ns: int) -> None:
        if self._faults and instant_ns > self.now_ns():
            instant_ns += self._late_ns(s_from_ns(instant_ns))
        super().advance_to(instant_ns)

    def _late_ns(self, now_s: float) -> int:
        lates_s = [
            fault.late_s
            for fault in self._faults
            if fault.at_s <= now_s < fault.until_s and fault.strikes(self._random)
        ]
        return ns_from_s(max(lates_s, default=0.0))


SENSOR_NAMES = {suffix.name: sensor for suffix, sensor in SENSORS.items()}

Ratio = Annotated[float, Field(ge=0.0, le=1.0)]
Seconds = Annotated[float, Field(ge=0.0)]
ServoId = Annotated[int, Field(ge=0, le=254)]


class FaultEntry(FileModel, title="fault"):
    """One fault: its kind, its time and its servo."""

    kind: str = Field(description="What happens.", json_schema_extra={"enum": list(FaultKind)})
    at_s: Seconds = Field(default=0.0, description="From when on, in seconds from power-up.")
    until_s: Seconds | None = Field(default=None, description="Until when. Left out: for ever.")
    servo: ServoId | None = Field(default=None, description="Id of the servo. Left out: all.")
    bus: str | None = Field(default=None, description="Name of the bus. Left out: all.")
    ratio: Ratio = Field(default=1.0, description="Which share of lines or replies it befalls.")
    late_s: Seconds | None = Field(default=None, description="How late a reply or the host is.")
    as_id: ServoId | None = Field(default=None, description="wrong_id: the id in the replies.")
    speed_ratio: Ratio | None = Field(default=None, description="weak: what is left of the speed.")
    temperature_c: Annotated[float, Field(ge=-40.0, le=200.0)] | None = Field(
        default=None, description="hot: the temperature that the servo has at once."
    )
    drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] | None = Field(
        default=None, description="clock_drift: millionths by which the servos' time runs faster."
    )
    deaf_s: Seconds | None = Field(
        default=None,
        description="reset, factory, exchanged: how long the servo is deaf; left out: 1.25.",
    )
    raw: Annotated[int, Field(ge=0, le=RAW_MAX)] | None = Field(
        default=None, description="input: the value of the converter."
    )
    distance_mm: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="input: instead of raw, a distance before a sensor."
    )
    sensor: str | None = Field(
        default=None,
        description="input: the model of that sensor.",
        json_schema_extra={"enum": list(SENSOR_NAMES)},
    )
    settings: Annotated[dict[str, float], Field(min_length=1)] | None = Field(
        default=None,
        description="stored: settings by name, in the units of `lss-motion reference`; ID as well. "
        "exchanged: those of the other servo that are not the factory's.",
        examples=[{"G": -1, "O": 5.0, "SD": 360}],
    )
    supply_v: Annotated[float, Field(ge=0.0, le=60.0)] | None = Field(
        default=None, description="low_voltage: what the supply gives without load."
    )
    setting: Literal["D", "SD", "AA", "AD", "T"] | None = Field(
        default=None, description="wrong_scale: the value that has another scale."
    )
    scale_ratio: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None,
        description="wrong_scale: one unit on the wire is so many times that of the documents.",
        examples=[0.1, 10],
    )
    text: str | None = Field(
        default=None,
        description="second_master: the line that another host sends, without its end.",
        examples=["#5QD", "#254L"],
    )
    every_s: Annotated[float, Field(ge=0.001)] | None = Field(
        default=None, description="second_master: how often it sends that line."
    )


class FaultsFile(FileModel, title="faults file"):
    """What goes wrong on the simulated buses."""

    version: Version = Field(default=FILE_VERSION, description=VERSION)
    faults: list[FaultEntry] = Field()


def load_faults(path: Path | str, robot: Robot | None = None) -> tuple[Fault, ...]:
    """Return the rows of a faults file; `InputError` says file, line, value and what is allowed.

    With a robot, rows that name a bus or a servo which it does not have are mistakes too.
    """
    from lss_motion.files.validation import validate
    from lss_motion.files.yaml_source import read_yaml

    source = read_yaml(Path(path))
    blanks = {"faults": FaultEntry(kind=FaultKind.DEAF)}
    content, problems, left_out = validate(FaultsFile, source, blanks=blanks)
    entries = [] if content is None else content.faults
    for index, entry in enumerate(entries):
        if ("faults", index) not in left_out:
            problems += _problems(index, entry)
            problems += [] if robot is None else _strangers(index, entry, robot)
            problems += _setting_problems(index, entry, robot)
    if problems:
        raise source.error(problems)
    return tuple(_fault(entry, robot) for entry in entries)


def _problems(index: int, entry: FaultEntry) -> list[Mistake]:
    from lss_motion.files.yaml_source import Mistake

    place = ("faults", index)
    if entry.kind not in list(FaultKind):
        known = known_names(entry.kind, map(str, FaultKind))
        return [Mistake((*place, "kind"), f"kind {entry.kind!r} is not known; {known}")]
    kind = FaultKind(entry.kind)
    given = entry.given
    problems = [Mistake(place, f"{kind} needs {key!r}") for key in kind.needs if key not in given]
    problems += [
        Mistake((*place, key), f"{key!r} says nothing about {kind}; leave it out")
        for key in sorted(given)
        if not kind.has(key)
    ]
    if entry.until_s is not None and kind in INSTANT:
        problems.append(Mistake((*place, "until_s"), f"{kind} happens once; leave until_s out"))
    elif entry.until_s is not None and entry.until_s <= entry.at_s:
        problems.append(
            Mistake((*place, "until_s"), f"until_s {entry.until_s:g} must be after {entry.at_s:g}")
        )
    if entry.servo is not None and kind in ABOUT_LINE:
        hint = "; for one servo use 'deaf'" if kind is not FaultKind.LOW_VOLTAGE else ""
        problems.append(Mistake((*place, "servo"), f"{kind} befalls the line{hint}"))
    if kind is FaultKind.INPUT:
        problems += _input_problems(index, entry)
    return problems


def _input_problems(index: int, entry: FaultEntry) -> list[Mistake]:
    from lss_motion.files.yaml_source import Mistake

    place = ("faults", index)
    has_distance = entry.distance_mm is not None
    if (entry.raw is None) is not has_distance:
        return [Mistake(place, "input needs 'raw', or 'distance_mm' with 'sensor'")]
    if has_distance is (entry.sensor is None):
        return [Mistake(place, "input needs 'distance_mm' and 'sensor' together")]
    if entry.sensor is not None and entry.sensor not in SENSOR_NAMES:
        known = known_names(entry.sensor, SENSOR_NAMES)
        return [Mistake((*place, "sensor"), f"sensor {entry.sensor!r} is not known; {known}")]
    return []


def _strangers(index: int, entry: FaultEntry, robot: Robot) -> list[Mistake]:
    """Return what a row names and the robot does not have."""
    from lss_motion.files.yaml_source import Mistake

    place = ("faults", index)
    if entry.bus is not None and entry.bus not in robot.buses:
        known = known_names(entry.bus, robot.buses)
        return [Mistake((*place, "bus"), f"robot {robot.name!r} has no bus {entry.bus!r}; {known}")]
    buses = robot.buses if entry.bus is None else {entry.bus}
    ids = {joint.servo_id for joint in robot.joints.values() if joint.bus in buses}
    if entry.kind == FaultKind.INPUT:
        models = {joint.model.family for joint in robot.joints.values() if joint.bus in buses}
        sensors = {one.servo_id for one in robot.sensors.values() if one.bus in buses}
        ids |= sensors
        if Family.IO2 not in models and not sensors:
            return [Mistake(place, f"robot {robot.name!r} has no LSS-2IO there, so no inputs")]
        ids |= {PIN_IDS[name] for name in PIN_IDS if name.startswith("A")}
    if entry.servo is not None and entry.servo not in ids:
        known = ", ".join(map(str, sorted(ids)))
        return [
            Mistake(
                (*place, "servo"),
                f"robot {robot.name!r} has no servo {entry.servo} there; known ids are {known}",
            )
        ]
    return []


def _setting_problems(index: int, entry: FaultEntry, robot: Robot | None) -> list[Mistake]:
    """Return the settings that a servo does not have, or not with that value."""
    from lss_motion.files.yaml_source import Mistake

    problems = []
    for name, value in (entry.settings or {}).items():
        try:
            _wire(name, value, _language(entry, robot))
        except ProtocolError as error:
            problems.append(Mistake(("faults", index, "settings", name), str(error)))
    return problems


def _language(entry: FaultEntry, robot: Robot | None) -> Family | Language:
    """Return the language of the servo of a row; LSS if that is not known."""
    joints = () if robot is None else robot.joints.values()
    return next(
        (
            joint.model.language
            for joint in joints
            if entry.servo in (None, joint.servo_id) and entry.bus in (None, joint.bus)
        ),
        Family.LSS,
    )


def _wire(name: str, value: float, language: Family | Language) -> int:
    """Return the wire value of a setting; raise `ProtocolError` as `stored_wire` does."""
    if name == "ID":
        row = language_table(language).row("CID")
        if not row.allows(round(value)):
            raise ProtocolError(f"ID {value:g}: {row.allowed()}")
        return round(value)
    wire = stored_wire(language, name, value)
    assert wire is not None, "a number was given"
    return wire


def _fault(entry: FaultEntry, robot: Robot | None) -> Fault:
    values = entry.known()
    values["kind"] = FaultKind(values.pop("kind"))
    if "servo" in values:
        values["servo_id"] = values.pop("servo")
    if entry.settings is not None:
        language = _language(entry, robot)
        values["settings"] = {n: _wire(n, value, language) for n, value in entry.settings.items()}
    sensor = values.pop("sensor", None)
    if sensor is not None:
        values["raw"] = SENSOR_NAMES[sensor].raw(values.pop("distance_mm"))
    return Fault(**values)
