"""Whether servos still have the settings of the session: a restart takes them away.

A servo that restarts is back with its stored settings, which may allow more than the joint does. It
does not report that. So the settings that a restart would change back, its probes, are read with
the health queries. Between two of them a restart shows by other signs: queries without an answer,
an angle to which the horn cannot have turned, a servo that is limp. With the first sign the servo
is in doubt and a probe is queried at once. With a few signs in a row, or an answer as after a
restart, it is sent no move until a probe is answered. The answer is right: its moves go on. It is
wrong: the servo has restarted.

One wrong answer is no proof, since a bus without checksums can deliver one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from lss_motion.playing.player.health import STATUS_TEXTS
from lss_motion.protocol.constants import Status
from lss_motion.robot.on_fault import Cause
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.robot.model import Joint


HOLD_SIGNS: Final = 3
"""Signs in a row after which a servo is sent no move. Chosen: on a line that loses every tenth
answer, that is one query in a thousand; a servo that does not answer at all is held back after
50 ms, since each query is given up after 10 to 15 ms."""
PROOFS: Final = 2
"""Wrong answers in a row that prove a restart."""
READ_BACK_NS: Final = 3 * NS_PER_S // 10
"""A probe of a servo is queried at least this often when it is its turn, however slow its line is:
a restart that nothing else shows is found by it. Chosen: on an idle line the health queries do that
every 0.25 s; three servos at 9600 bps need a tenth of the line for it."""


class Watched(Protocol):
    """What the watch needs of the state of a joint."""

    joint: Joint

    def hold_back(self) -> None:
        """Send no move to the servo: it may have lost its limits."""


class Probe(NamedTuple):
    """The query of one setting, with answers as wire values."""

    keyword: str
    value: int
    """The answer of a servo that has not restarted."""
    original: int | None
    """The answer before the show, and probably after a restart."""


@dataclass(slots=True)
class _Doubt:
    """Signs of a restart of one servo since its last right answer."""

    signs: int = 0
    last_ns: int = -1
    proofs: int = 0
    wrong: dict[str, int] = field(default_factory=dict)
    """The last wrong answer by keyword."""


class Silence:
    """Whether several servos of one bus fell silent together: their common power may have failed.

    A servo that is silent while another one answers has its own reason, until it answers again.
    """

    def __init__(self) -> None:
        self._timeouts: Counter[int] = Counter()
        """By servo id, since the last answer on the bus."""
        self._mute: set[int] = set()

    def answered(self, servo_id: int | None) -> None:
        """Note an answer of a servo; None: the answer does not say of which."""
        if self._timeouts:
            self._mute.update(self._timeouts)
            self._timeouts.clear()
        if servo_id in self._mute:
            self._mute.remove(servo_id)

    def unanswered(self, servo_id: int) -> bool:
        """Note a query without an answer; return whether several servos fell silent together.

        Besides those of one servo that takes `HOLD_SIGNS` less one timeouts of others.
        """
        if servo_id in self._mute:
            return False
        self._timeouts[servo_id] += 1
        return self._timeouts.total() - max(self._timeouts.values()) >= HOLD_SIGNS - 1


class SettingsWatch:
    """Watches the servos of one streamer; `probes` by joint name.

    A joint without a probe has the same settings after a restart, so it is never in doubt.
    """

    def __init__(self, probes: Mapping[str, Sequence[Probe]]) -> None:
        self._probes = probes
        self._keywords = {
            name: tuple(probe.keyword for probe in own) for name, own in probes.items()
        }
        self._doubts: dict[str, _Doubt] = {}
        self.doubted = self._doubts.keys()
        """The joints whose settings are in doubt."""
        self._restarted: set[str] = set()
        """Joints whose servo was proved to have restarted."""
        self._read_backs: dict[str, tuple[int, int]] = {}
        """By joint, the instant of its last probe, and the number of probes so far."""

    def keywords(self, name: str) -> tuple[str, ...]:
        """Return the keywords of the probes of a joint."""
        return self._keywords.get(name, ())

    def urgent(self, name: str) -> str | None:
        """Return the probe that must be queried at once; None: there is no doubt.

        After a timeout it is another one. A late answer to an earlier query is as good.
        """
        if (doubt := self._doubts.get(name)) is None:
            return None
        words = self.keywords(name)
        return words[doubt.signs % len(words)]

    def allows_moves(self, name: str) -> bool:
        """Return whether the settings of a joint are not in doubt, and not known to be lost."""
        return name not in self._doubts and name not in self._restarted

    def trust(self, name: str) -> None:
        """Note that a servo that had restarted was given its settings again."""
        self._restarted.discard(name)

    def read_back(self, name: str, now_ns: int) -> str | None:
        """Return the probe that must be queried since the last one was too long ago."""
        words = self._keywords.get(name)
        if not words or name in self._restarted:
            return None
        if name not in self._read_backs:
            return words[0]
        last_ns, count = self._read_backs[name]
        return None if now_ns - last_ns < READ_BACK_NS else words[count % len(words)]

    def note_query(self, name: str, keyword: str, now_ns: int) -> None:
        """Note a query that was sent to the servo of a joint."""
        if keyword in self.keywords(name):
            _, count = self._read_backs.get(name, (0, 0))
            self._read_backs[name] = now_ns, count + 1

    def note_sign(self, state: Watched, now_ns: int, *, count: int = 1) -> None:
        """Note a sign of a restart that counts `count` times; several at one instant are one."""
        name = state.joint.name
        if not self._probes.get(name) or name in self._restarted:
            return
        doubt = self._doubts.setdefault(name, _Doubt())
        if doubt.last_ns != now_ns:
            doubt.last_ns = now_ns
            doubt.signs += count
        if doubt.signs >= HOLD_SIGNS:
            state.hold_back()

    def take(self, state: Watched, keyword: str, value: int | None) -> str | None:
        """Judge the answer to a probe; return the text of the fault if the servo has restarted.

        A right answer ends the doubt. `state` may then be sent moves again.
        """
        name = state.joint.name
        probe = next(probe for probe in self._probes[name] if probe.keyword == keyword)
        if name in self._restarted:
            return None  # That is reported; its settings are sent by the recovery.
        if value == probe.value:
            self._doubts.pop(name, None)
            return None
        doubt = self._doubts.setdefault(name, _Doubt())
        if value is None or value not in (probe.original, doubt.wrong.get(keyword)):
            doubt.proofs = 0
            if value is not None:
                doubt.wrong[keyword] = value
            return None
        doubt.proofs += 1
        state.hold_back()
        if doubt.proofs < PROOFS:
            return None
        del self._doubts[name]
        self._restarted.add(name)
        return (
            f"has lost its settings: servo {state.joint.servo_id} answers {value} to {keyword}, it "
            f"was set to {probe.value}. It has restarted. Look at its power supply"
        )


class ServoWatch:
    """Watches one servo outside of a show: whether it has restarted since it was set up.

    Its owner sends no move while it `is_doubtful`.
    """

    def __init__(self, joint: Joint) -> None:
        self.joint = joint
        self.powered_ns: int | None = None
        """When the servo received what gives its motor power; None: it may be limp."""
        self._watch = SettingsWatch({})
        self.is_limp = False
        """Whether its last status was that of a limp servo although it has power."""

    def begin(self, probes: Sequence[Probe]) -> None:
        """Watch from now on: the servo was set to these."""
        self._watch = SettingsWatch({self.joint.name: probes})

    def hold_back(self) -> None:
        """Send no move to the servo: `is_doubtful` says so."""

    @property
    def has_settings(self) -> bool:
        """Whether its settings are not in doubt, and not known to be lost."""
        return self._watch.allows_moves(self.joint.name)

    @property
    def is_doubtful(self) -> bool:
        """Whether the servo may have restarted, or has."""
        return self.is_limp or not self.has_settings

    @property
    def keywords(self) -> tuple[str, ...]:
        """The queries whose answers `take` judges."""
        return self._watch.keywords(self.joint.name)

    @property
    def urgent(self) -> str | None:
        """The query that must be sent at once; None: there is no doubt."""
        return self._watch.urgent(self.joint.name)

    def note_timeout(self, now_ns: int) -> None:
        """Note a query without an answer."""
        self._watch.note_sign(self, now_ns)

    def take(self, keyword: str, value: int | str | None) -> str | None:
        """Judge the answer to a probe; return the text of the fault if the servo has restarted."""
        return self._watch.take(self, keyword, value if isinstance(value, int) else None)

    def take_status(self, status: Status, asked_ns: int) -> str | None:
        """Judge a status; return the fault of a servo that is limp twice although it has power."""
        was_limp = self.is_limp
        is_driven = self.powered_ns is not None and asked_ns > self.powered_ns
        self.is_limp = is_driven and status is Status.LIMP
        if not self.is_limp:
            return None
        self._watch.note_sign(self, asked_ns)
        return STATUS_TEXTS[Cause.RESTARTED] if was_limp else None

    def trust(self) -> None:
        """Note that the servo has the settings again that it had lost."""
        self._watch.trust(self.joint.name)
        self.is_limp, self.powered_ns = False, None
