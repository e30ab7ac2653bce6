"""What the sources of triggers share: whose messages are obeyed, and how many.

A source turns messages into operations of `playing.remote.schema` and calls `Sink` with each, in
the one thread of the server. A message from an address that may not send, one that cannot be read
and one too many are counted, and noted at most once in `REPORT_S` for each cause: a flood fills no
log.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from lss_motion.playing.remote import schema as m

T = TypeVar("T")

DEEDS: Final = {
    "go": "go",
    "stop": "stop",
    "estop": "estop",
    "pause": "pause",
    "resume": "resume",
    "idle": "stage.stop",
    "rest": "stage.rest",
    "wake": "stage.wake",
}
"""Operations without an argument, by their words. No `rearm`: after a stop a person with a password
allows motion again."""
RATE_HZ: Final = 200.0
BURST: Final = 100.0
"""Messages of one sender that are looked at. Chosen: a fader sends 60 a second."""
REPORT_S: Final = 60.0
CAUSES_MAX: Final = 64
"""Causes that are told apart; further ones are counted as one."""
SENDERS_MAX: Final = 64
"""Allowed senders with a rate of their own; further ones share one."""


class Sink(Protocol):
    """Takes what a source has received."""

    def __call__(self, operation: m.AnyOperation, origin: str) -> None:
        """Carry an operation out; `origin` says for people where it comes from."""


class AllowList:
    """Addresses that may send without a password."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = tuple(ipaddress.ip_network(one, strict=False) for one in networks)

    def has(self, host: str) -> bool:
        """Return whether the computer at this address may send."""
        try:
            address = ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            return False
        mapped = getattr(address, "ipv4_mapped", None)
        found = address if mapped is None else mapped
        return any(found in network for network in self._networks)


class RateLimit:
    """A burst of messages, then a steady rate."""

    def __init__(self, rate_hz: float = RATE_HZ, burst: float = BURST) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._left, self._at_s = burst, 0.0

    def has_room(self, now_s: float) -> bool:
        """Return whether one more message is looked at now; take its place."""
        gained = max(0.0, now_s - self._at_s) * self._rate_hz
        self._left, self._at_s = min(self._burst, self._left + gained), now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Crossings:
    """Which values of a source cross a threshold of a cue; only these are sent to the player.

    `thresholds` has those of each address. A value must fall `hysteresis` below one before it can
    cross that one again. With `is_state` a source reports how things are, again and again, and the
    first value of it crosses nothing: a level that is up when the stage begins starts no show.
    """

    def __init__(
        self,
        thresholds: Mapping[str, Collection[float]],
        *,
        hysteresis: float = 0.0,
        is_state: bool = False,
    ) -> None:
        self._thresholds = {name: tuple(own) for name, own in thresholds.items()}
        self._hysteresis, self._is_state = hysteresis, is_state
        self._above: dict[tuple[str, float], bool] = {}

    def __contains__(self, address: str) -> bool:
        return address in self._thresholds

    def take(self, address: str, value: float) -> bool:
        """Return whether this value crosses a threshold, up or down."""
        has_crossed = False
        for threshold in self._thresholds.get(address, ()):
            key = (address, threshold)
            before = self._above.get(key, None if self._is_state else False)
            low = threshold - self._hysteresis if before else threshold
            self._above[key] = is_above = value > low
            has_crossed |= before is not None and is_above is not before
        return has_crossed

    def forget(self, address: str) -> None:
        """Note that a source is gone: its next value is a first one."""
        for threshold in self._thresholds.get(address, ()):
            self._above.pop((address, threshold), None)


class Complaints:
    """What is wrong with what arrives: counted, noted once in `REPORT_S` for a cause."""

    def __init__(self, name: str, note: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._name, self._note = name, note
        self._reported_s: dict[str, float] = {}
        self._since: Counter[str] = Counter()

    def add(self, cause: str, now_s: float) -> None:
        """Count a message that was not obeyed, and note it if that was not noted just now."""
        if cause not in self.counts and len(self.counts) >= CAUSES_MAX:
            cause = "messages with further faults were ignored"
        self.counts[cause] += 1
        self._since[cause] += 1
        reported_s = self._reported_s.get(cause)
        if reported_s is not None and now_s - reported_s < REPORT_S:
            return
        count = self._since.pop(cause)
        times = "" if count == 1 else f" ({count} times)"
        self._reported_s[cause] = now_s
        self._note(f"{self._name}: {cause}{times}")


class Gate:
    """Decides which messages of a source are read: allowed senders, each at a bounded rate.

    So one that floods takes no message from another, which may be a stop.
    """

    def __init__(
        self,
        name: str,
        allow: AllowList,
        note: Callable[[str], None],
        *,
        rate_hz: float = RATE_HZ,
    ) -> None:
        self.complaints = Complaints(name, note)
        self.received = 0
        self._allow, self._rate_hz = allow, rate_hz
        self._limits: dict[str, RateLimit] = {}

    def tried(self, call: Callable[[], T], host: str, now_s: float) -> T | None:
        """Return what a call makes of a message; None, and a complaint, if it cannot be obeyed."""
        try:
            return call()
        except InputError as error:
            self.complaints.add(f"{error} (from {host})", now_s)
            return None

    def admits(self, host: str, now_s: float) -> bool:
        """Return whether a message from this address is read; count it otherwise."""
        self.received += 1
        if not self._allow.has(host):
            text = f"a message from {host} is ignored; add the address to `allow` under `listen`"
            self.complaints.add(text, now_s)
            return False
        own = host if host in self._limits or len(self._limits) < SENDERS_MAX else ""
        if not self._limits.setdefault(own, RateLimit(self._rate_hz)).has_room(now_s):
            text = f"{host} sends more than {self._rate_hz:.0f} messages a second; the rest is lost"
            self.complaints.add(text, now_s)
            return False
        return True
