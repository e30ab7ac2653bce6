"""A stage of many computers in virtual time: links, clocks, conductor and figures.

Links and clocks are drawn by seed from models; `LOOPBACK` and `WIFI` are fitted to measured
exchanges (`exchanges.json`, made by `tools/rig/exchanges.py --write`; compared in
`tools/run tools/bench.py network`). Conductor, figures and clock estimators are those of
the package. A player is reduced to what it tells its figure; where moves are judged, real players
follow the legs that are recorded here (`benches.network`).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING, Any, Final

from lss_motion.playing.player.events import Phase
from lss_motion.stage.hosts.clocks import BURST_NS, EVERY_NS, ClockEstimator, Exchange
from lss_motion.stage.hosts.conductor import BEAT_NS, Conductor, ConductorState, Wish
from lss_motion.stage.hosts.figure import (
    Action,
    ArmPlayer,
    Fetch,
    FollowingFigure,
    FollowLeg,
    PlayerReport,
    StopPlayer,
    Verify,
)
from lss_motion.stage.hosts.messages import Cast, Part, hash_of, packed
from lss_motion.units import NS_PER_MS, NS_PER_S, NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Callable

TICK_NS: Final = 10 * NS_PER_MS
STATUS_NS: Final = 200 * NS_PER_MS
FREEWHEEL_NS: Final = 3 * NS_PER_S
"""As a player freewheels from the last beat on (`player_link.PlayerLink`)."""
RETRANSMIT_NS: Final = 210 * NS_PER_MS
"""What is lost on a line of TCP arrives so much later (the least of Linux, 200 ms)."""


@dataclass(frozen=True)
class LinkModel:
    """Delay of one message: `base`, an exponential part, sometimes a spike, sometimes a loss."""

    base_ns: int
    jitter_ns: int
    spike_ratio: float = 0.0
    spike_ns: int = 0
    loss_ratio: float = 0.0

    def delay_ns(self, random: Random) -> int:
        delay = self.base_ns + random.expovariate(1.0) * self.jitter_ns
        if random.random() < self.spike_ratio:
            delay += random.random() * self.spike_ns
        if random.random() < self.loss_ratio:
            delay += RETRANSMIT_NS
        return round(delay)


LOOPBACK: Final = LinkModel(290 * NS_PER_US, 140 * NS_PER_US, 0.01, NS_PER_MS)
"""One way between two namespaces, zenoh over TCP; fitted to `wired` of `exchanges.json`."""
WIFI: Final = LinkModel(1500 * NS_PER_US, 3500 * NS_PER_US, 0.02, 80 * NS_PER_MS, 0.005)
"""The same through the proxy of the rig; fitted to `wifi`. Spikes and losses are the proxy's."""


@dataclass
class ClockModel:
    """A clock: `own = true + offset + ppm`, and jumps at true instants."""

    offset_ns: int = 0
    ppm: float = 0.0
    jumps: list[tuple[int, int]] = field(default_factory=list)

    def own_ns(self, true_ns: int) -> int:
        jumped = sum(by_ns for at_ns, by_ns in self.jumps if true_ns >= at_ns)
        return true_ns + self.offset_ns + round(true_ns * self.ppm * 1e-6) + jumped

    def true_ns(self, own_ns: int) -> float:
        """Return the true instant, of a clock without jumps."""
        return (own_ns - self.offset_ns) / (1.0 + self.ppm * 1e-6)


def reported(does: str, show_s: float | None = None, **fields: Any) -> PlayerReport:  # noqa: ANN401
    """Return what a player reports that does this (`figure.Does`)."""
    phases = {"starting": Phase.APPROACH, "stopping": Phase.STOP}
    return PlayerReport(
        is_running=does in ("starting", "standing", "playing", "stopping"),
        phase=phases.get(does, Phase.SHOW),
        show_s=show_s,
        outcome={"ended": "finished", "failed": "failed"}.get(does, ""),  # type: ignore[arg-type]
        **fields,
    )


class ModelPlayer:
    """What a player reports: started, it stands after `arm_ns`, and plays from the first leg on.

    Without legs it goes on for `FREEWHEEL_NS`, and then stands.
    """

    def __init__(self, arm_ns: int, duration_s: float) -> None:
        self.report = PlayerReport()
        self.does = "none"
        self.follows: list[tuple[int, FollowLeg]] = []
        self.stops = 0
        self._arm_ns, self._duration_s = arm_ns, duration_s
        self._at_ns = 0
        self._leg: FollowLeg | None = None
        self._coming: FollowLeg | None = None
        self._told_ns = 0
        self.starts = 0
        self.way_ns = 0
        """How long the robot goes to a place that was sought."""
        self._there_ns = 0

    def becomes(self, does: str, show_s: float | None = None, **fields: Any) -> None:  # noqa: ANN401
        """Do something else, and report it."""
        self.does, self.report = does, reported(does, show_s, **fields)

    def act(self, action: Action, now_ns: int) -> None:
        match action:
            case ArmPlayer():
                self.becomes("starting")
                self._at_ns = now_ns + self._arm_ns
                self._leg = self._coming = None
                self.starts += 1
            case FollowLeg() if self.does in ("standing", "playing"):
                self.follows.append((now_ns, action))
                self._told_ns = max(now_ns, action.instant_ns)
                if self._leg is None or action.instant_ns <= now_ns:
                    self._leg, self._coming = action, None
                else:
                    self._coming = action
            case StopPlayer() if self.does != "none":
                self.stops += 1
                self.becomes("stopping")
                self._at_ns = now_ns + NS_PER_S // 2

    def tick(self, now_ns: int) -> PlayerReport:
        if self.does == "starting" and now_ns >= self._at_ns:
            self.becomes("standing", 0.0)
        elif self.does == "stopping" and now_ns >= self._at_ns:
            self.becomes("none")
        elif self.does in ("standing", "playing") and self._leg is not None:
            if self._coming is not None and now_ns >= self._coming.instant_ns:
                self._leg, self._coming = self._coming, None
            if now_ns >= self._leg.instant_ns:
                self._follow(self._leg, now_ns)
        return self.report

    def _follow(self, leg: FollowLeg, now_ns: int) -> None:
        until_ns = min(now_ns, self._told_ns + FREEWHEEL_NS)
        show_s = leg.show_s + leg.rate * (until_ns - leg.instant_ns) / NS_PER_S
        if leg.rate == 0.0 and show_s != self.report.show_s:
            self._there_ns = leg.instant_ns + self.way_ns
        stands = until_ns < now_ns or (leg.rate == 0.0 and now_ns >= self._there_ns)
        if show_s >= self._duration_s:
            self.becomes("ended")
        else:
            self.becomes("playing", show_s, stands=stands)


class Host:
    """One figure with its clock, its link to the conductor and its player."""

    def __init__(
        self, name: str, world: World, clock: ClockModel, link: LinkModel, *, seed: int
    ) -> None:
        self.name, self.world, self.clock, self.link = name, world, clock, link
        self.random = Random(f"{seed}/{name}")  # noqa: S311
        self.is_cut = False
        self._instances = 0
        self.log: list[str] = []
        self.start()

    def start(self) -> None:
        """Start, or start again with an empty memory."""
        self._instances += 1
        self.figure = FollowingFigure(
            name=self.name,
            conductor=self.world.conductor.name,
            robot=self.world.robots.get(self.name, hash_of(self.name.encode())),
            instance=hash_of(f"{self.name} {self._instances}".encode())[:16],
            version="model",
        )
        self.estimator = ClockEstimator()
        self.player = ModelPlayer(self.random.randint(1500, 4000) * NS_PER_MS, self.world.show_s)
        self._clock_ns = self._status_ns = 0
        self._last_state = ""
        self.arrivals_ns: dict[str, int] = {}

    def now_ns(self) -> int:
        return self.clock.own_ns(self.world.now_ns)

    def tick(self) -> None:
        world, now_ns = self.world, self.now_ns()
        if world.now_ns >= self._clock_ns:
            pace = EVERY_NS if self.estimator.is_ready else BURST_NS
            self._clock_ns = world.now_ns + pace
            self._exchange()
        self.figure.take_clock(self.estimator.estimate(now_ns), self.estimator.round_trip_ns)
        self.figure.take_player(self.player.tick(now_ns))
        for action in self.figure.tick(now_ns):
            self._do(action, now_ns)
        self.log += self.figure.take_notes()
        state = self.figure.state
        if state != self._last_state or world.now_ns >= self._status_ns:
            self._last_state, self._status_ns = state, world.now_ns + STATUS_NS
            status = self.figure.status(now_ns)
            world.to_conductor_bytes += len(packed(status)) + world.overhead_bytes
            world.send(
                self, lambda: world.conductor.take_status(status, world.now_ns), "to conductor"
            )

    def _do(self, action: Action, now_ns: int) -> None:
        world = self.world
        match action:
            case Fetch():
                content = world.store.get(action.hash)
                if content is not None:
                    world.fetch(self, content)
            case Verify():
                world.at(world.verify_ns, lambda: self.figure.take_verified(action.plan, ""))
            case _:
                self.player.act(action, now_ns)

    def _exchange(self) -> None:
        world = self.world
        if self.is_cut:
            return
        out, back = self.link.delay_ns(self.random), self.link.delay_ns(self.random)
        served_ns = 50 * NS_PER_US
        start = world.now_ns + self.random.randint(0, world.tick_ns)
        made = Exchange(
            self.clock.own_ns(start),
            start + out,
            start + out + served_ns,
            self.clock.own_ns(start + out + served_ns + back),
        )
        world.to_conductor_bytes += world.clock_bytes
        world.at(start - world.now_ns + out + served_ns + back, lambda: self.estimator.add(made))


class World:
    """Conductor and figures. True time is that of the conductor's clock."""

    def __init__(  # noqa: PLR0913
        self,
        hosts: int,
        *,
        link: LinkModel = LOOPBACK,
        seed: int = 0,
        ppm: float = 100.0,
        show_s: float = 30.0,
        plan_bytes: int = 1000,
        line_bytes_s: float = 100e6,
        others: str = "hold",
        robots: dict[str, str] | None = None,
    ) -> None:
        random = Random(f"{seed}/world")  # noqa: S311
        self.random, self.now_ns, self.show_s = random, 0, show_s
        self.tick_ns = TICK_NS
        self.robots = robots or {}
        self.overhead_bytes, self.clock_bytes = 60, 2 * 160
        self.verify_ns = NS_PER_S // 2
        self.line_bytes_s = line_bytes_s
        self._line_ns = 0
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._serial = 0
        self._last: dict[tuple[str, str], int] = {}
        self.to_conductor_bytes = self.from_conductor_bytes = 0
        names = [f"f{index}" for index in range(hosts)]
        plans = {name: f"{name} {seed}".encode().ljust(plan_bytes, b".") for name in names}
        parts = {
            name: Part(plan=hash_of(plans[name]), robot=hash_of(name.encode())) for name in names
        }
        self.cast = Cast(show="model", duration_s=show_s, parts=parts)
        self.store = {hash_of(plan): plan for plan in plans.values()}
        self.store[hash_of(packed(self.cast))] = packed(self.cast)
        self.conductor = Conductor(
            name=names[0],
            figures=names,
            epoch=1,
            instance=hash_of(b"conductor")[:16],
            others=others,  # type: ignore[arg-type]
        )
        self._number = 0
        self.told: list[tuple[Any, ...]] = []
        """What became of orders, each with its number."""
        self.conductor.listener = self
        self.is_conducting = True
        self.notes: list[str] = []
        self.hosts = {}
        for name in names:
            clock = ClockModel(random.randrange(10**12), random.uniform(-ppm, ppm))
            self.hosts[name] = Host(name, self, clock, link, seed=seed)
        self._beat_ns = 0
        self._beaten: tuple[object, ...] = ()

    def at(self, delay_ns: int, call: Callable[[], None]) -> None:
        """Call something so much later."""
        self._serial += 1
        heapq.heappush(self._events, (self.now_ns + delay_ns, self._serial, call))

    def send(self, host: Host, call: Callable[[], None], way: str) -> None:
        """Deliver a message over the link of `host`, in order."""
        if host.is_cut:
            return
        key = (host.name, way)
        arrives = max(self.now_ns + host.link.delay_ns(host.random), self._last.get(key, 0) + 1)
        self._last[key] = arrives
        self.at(arrives - self.now_ns, call)

    def fetch(self, host: Host, content: bytes) -> None:
        """Deliver content after what else the line of the conductor carries."""
        if host.is_cut:
            return
        self.from_conductor_bytes += len(content)
        begin = max(self._line_ns, self.now_ns)
        self._line_ns = begin + round(len(content) / self.line_bytes_s * NS_PER_S)
        delay = self._line_ns - self.now_ns + 2 * host.link.delay_ns(host.random)
        self.at(delay, lambda: host.figure.take_content(content))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time pass; return whether `until` came true."""
        end_ns = self.now_ns + round(seconds * NS_PER_S)
        while self.now_ns < end_ns:
            if until():
                return True
            self._tick()
        return until()

    def _tick(self) -> None:
        goal = self.now_ns + self.tick_ns
        while self._events and self._events[0][0] <= goal:
            at_ns, _, call = heapq.heappop(self._events)
            self.now_ns = max(self.now_ns, at_ns)
            call()
        self.now_ns = goal
        if self.is_conducting:
            self.notes += self.conductor.tick(self.now_ns)
            conductor = self.conductor
            state = (conductor.wanted, conductor.run, conductor.legs.newest, conductor.cast)
            if self.now_ns >= self._beat_ns or state != self._beaten:
                self._beat_ns, self._beaten = self.now_ns + BEAT_NS, state
                self._beat()
        for host in self.hosts.values():
            host.tick()

    def _beat(self) -> None:
        beat = self.conductor.beat()
        size = len(packed(beat)) + self.overhead_bytes
        for host in self.hosts.values():
            self.from_conductor_bytes += size
            figure = host.figure
            self.send(
                host,
                lambda host=host, figure=figure: figure.take_beat(beat, host.now_ns()),
                "from conductor",
            )

    def states(self) -> set[str]:
        """Return the states of all figures."""
        return {host.figure.state for host in self.hosts.values()}

    def connected(self, text: str, now_ns: int) -> None:  # noqa: ARG002  (`conductor.Listener`)
        """Note that the stage may begin."""
        self.told.append(("connected", text))

    def refused(self, number: int, reason: str, now_ns: int) -> None:  # noqa: ARG002
        """Note that a show was refused."""
        self.told.append(("refused", number, reason))

    def ended(self, number: int, outcome: str, show_s: float | None, now_ns: int) -> None:  # noqa: ARG002
        """Note that a show is over."""
        self.told.append((outcome, number, show_s))

    def faulted(self, cause: str, text: str, now_ns: int) -> None:  # noqa: ARG002
        """Note that a show ended with a fault."""
        self.told.append(("faulted", cause, text))

    def play(self, **fields: Any) -> None:  # noqa: ANN401
        """Order the show, as the director would."""
        self._number += 1
        self.conductor.play(Wish(number=self._number, cast=self.cast, **fields), self.now_ns)

    def wait(self, *states: ConductorState, seconds: float = 60.0) -> None:
        """Let time pass until the conductor is in one of these states."""
        assert self.run(seconds, lambda: self.conductor.state in states), self.notes

    def go(self) -> None:
        """Play the show from its start."""
        self.play()
        self.wait(ConductorState.PLAYING)

    def spread_ns(self, show_s: float) -> list[float]:
        """Return at which true instants the hosts are at `show_s`, by the legs they were told."""
        found = []
        for host in self.hosts.values():
            told = [follow for _, follow in host.player.follows if follow.rate > 0.0]
            if not told:
                continue
            own_ns = [
                follow.instant_ns + (show_s - follow.show_s) / follow.rate * NS_PER_S
                for follow in told
            ]
            # The leg that was the newest when the host was there.
            pairs = [
                at
                for (told_ns, _), at in zip(host.player.follows, own_ns, strict=False)
                if told_ns <= at
            ]
            found.append(host.clock.true_ns(round((pairs or own_ns[:1])[-1])))
        return found
