"""Records all of a run, presses its keys, and ends it if it does not end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING, Final

from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.player import Player

RUN_MAX_S: Final = 150.0
"""Virtual time. Ten waits of `RESUME_S` with an approach each, and a show at a tenth of its speed,
take less."""
TURNS_MAX: Final = 300_000
SPINS_MAX: Final = 100
"""Turns at one and the same instant: a player that asks to be woken when nothing is due spins."""

ACTS_MAX: Final = 3
PAUSE_S: Final = (0.05, 1.0)

Act = tuple[float, Callable[["Player", int], None]]
"""When a key is pressed, and what it does."""


def random_acts(seed: int, duration_s: float) -> list[Act]:
    """Return up to three random keys: pause and resume, slower, stop."""
    random = Random(f"{seed}/acts")
    acts: list[Act] = []
    for _ in range(random.randint(0, ACTS_MAX)):
        at_s = random.uniform(0.0, duration_s + 2.0)
        kind = random.choice(("pause", "pause", "pause", "slower", "slower", "stop"))
        if kind == "stop":
            acts.append((at_s, lambda player, now_ns: player.stop(now_ns)))
            continue
        rate = 0.0 if kind == "pause" else random.uniform(0.3, 1.0)
        acts.append((at_s, lambda player, now_ns, rate=rate: player.set_rate(rate, now_ns)))
        again_s = at_s + random.uniform(*PAUSE_S)
        acts.append((again_s, lambda player, now_ns: player.set_rate(1.0, now_ns)))
    return sorted(acts, key=lambda act: act[0])


class HangError(Exception):
    """The run does not end."""


@dataclass
class Witness:
    """Records bytes and phases, and ends a run that does not end."""

    acts: list[Act] = field(default_factory=list)
    """Keys that will be pressed, in order of time."""
    has_acted: bool = False
    sent_data: dict[str, bytearray] = field(default_factory=dict)
    writes: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    """What was written to each bus, and when."""
    phases: list[tuple[int, Phase]] = field(default_factory=list)
    turns: int = 0
    spins: int = 0
    end_ns: int = 0

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        self.sent_data.setdefault(bus, bytearray()).extend(data)
        self.writes.setdefault(bus, []).append((now_ns, data))

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        """Say nothing: what the servos answer is their affair."""

    def turned(self, now_ns: int) -> None:
        """Say nothing: `act` counts."""

    def requested(self, request: object, now_ns: int) -> None: ...

    def noted(self, bus: str, state: str, now_ns: int, reason: str = "") -> None:
        """Note nothing: the bytes are enough."""

    def happened(self, event: Event, now_ns: int) -> None:
        if isinstance(event, PhaseEntered):
            self.phases.append((now_ns, event.phase))

    def filenos(self) -> Sequence[int]:
        return []

    def act(self, driven: Player, now_ns: int) -> None:
        self.turns += 1
        while self.acts and self.acts[0][0] * NS_PER_S <= now_ns:
            self.acts.pop(0)[1](driven, now_ns)
            self.has_acted = True
        self.spins = self.spins + 1 if now_ns == self.end_ns else 0
        self.end_ns = now_ns
        is_over = now_ns > RUN_MAX_S * NS_PER_S or self.turns > TURNS_MAX
        if is_over or self.spins > SPINS_MAX:
            raise HangError(
                f"{self.turns} turns and {s_from_ns(now_ns):.0f} s, still {driven.phase.value}"
            )
