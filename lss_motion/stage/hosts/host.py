"""One computer of a stage: its figure, the conductor if it is that one, and its player.

`Host.turn` is called again and again by one thread. It takes what the network delivered, lets
`FollowingFigure` and `Conductor` decide, and does what they say. The player is a process of its own
(`PlayerLink`): whatever happens to this one, it brakes and holds.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

from msgspec import to_builtins
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.stage.hosts.clocks import BURST_NS, EVERY_NS, ClockEstimator, Exchange
from lss_motion.stage.hosts.conductor import BEAT_NS, Conductor
from lss_motion.stage.hosts.examine import Examining
from lss_motion.stage.hosts.figure import (
    Action,
    ArmPlayer,
    Fetch,
    FollowingFigure,
    FollowLeg,
    StopPlayer,
    Verify,
)
from lss_motion.stage.hosts.messages import (
    Ask,
    Catalogue,
    ClockAnswer,
    ClockQuestion,
    ConductorBeat,
    Examine,
    FigureStatus,
    Findings,
    StopAll,
    hash_of,
    other_protocol,
    packed,
    parse,
)
from lss_motion.stage.hosts.plans import robot_hash
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from lss_motion.robot.model import Robot
    from lss_motion.stage.hosts.conductor import Others
    from lss_motion.stage.hosts.messages import Cast
    from lss_motion.stage.hosts.peer import NetworkArrival, NetworkSettings, Peer
    from lss_motion.stage.hosts.plans import PlanStore
    from lss_motion.stage.hosts.player_link import PlayerLink

TURN_S: Final = 0.005
"""A turn waits for messages at most so long."""
TICK_NS: Final = 20 * NS_PER_MS
"""The conductor looks after its figures so often: of 200 it takes 0.3 ms, and a thousand of their
messages arrive in a second (`tools/run tools/bench.py network`)."""
STATUS_NS: Final = 200 * NS_PER_MS
STOPS: Final = 10
STOP_NS: Final = 50 * NS_PER_MS
"""A stop is sent so often, so far apart; every beat repeats it besides."""
ASKS_MAX: Final = 200
ASK_TIMES: Final = 3
"""A wish is sent so often: TCP loses none, but a full queue may."""


class Host:
    """One computer. `log` gets what happens, a line each."""

    def __init__(  # noqa: PLR0913  (what one computer has)
        self,
        settings: NetworkSettings,
        robot: Robot,
        player: PlayerLink,
        store: PlanStore,
        make_peer: Callable[[str], Peer],
        *,
        version: str,
        others: Others = "hold",
        log: Callable[[str], None] = lambda _text: None,
        examine: Callable[[int], Findings] | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.settings, self.player, self.log = settings, player, log
        self._store, self._now_ns = store, now_ns
        self.instance = secrets.token_hex(8)
        self.figure = FollowingFigure(
            name=settings.figure,
            conductor=settings.conductor,
            robot=robot_hash(robot),
            instance=self.instance,
            version=version,
        )
        self.estimator = ClockEstimator()
        self.conductor: Conductor | None = None
        if settings.is_conductor:
            self.conductor = Conductor(
                name=settings.figure,
                figures=settings.figures,
                epoch=1,
                instance=self.instance,
                others=others,
            )
        self.cues: deque[tuple[str, Ask]] = deque(maxlen=100)
        """Cues and triggers that figures asked for, each with the figure."""
        self._examining: Examining | None = None
        self.findings: dict[str, Findings] = {}
        """What figures found about themselves (conductor only)."""
        self._examine, self._examined = examine, 0
        self._found: Findings | None = None
        self._verified: deque[tuple[str, str | None]] = deque()
        """Plans with why they cannot be played; None: they are stored no more."""
        self._asks: deque[Ask] = deque(maxlen=ASKS_MAX)
        self._asked: dict[str, deque[tuple[str, int]]] = {}
        """The wishes of each figure that were obeyed last: repeated ones are the same."""
        self._ask_count = 0
        self._stops, self._stops_left = 0, 0
        """What the conductor has stopped, and how often that is still to be sent."""
        self._clock_of = ""
        self._due_ns = {"clock": 0, "status": 0, "beat": 0, "stop": 0, "ask": 0, "tick": 0}
        self._sent_beat: tuple[object, ...] = ()
        self._sent_state = ""
        self.peer = make_peer(self.instance)
        self._join()

    def _join(self) -> None:
        peer, name = self.peer, self.settings.figure
        peer.subscribe("beat")
        peer.subscribe("stop")
        peer.subscribe(f"clock/{name}")
        peer.watch("conductor/alive")
        peer.announce(f"figure/{name}/alive")
        if self.conductor is not None:
            peer.subscribe("figure/*/status")
            peer.subscribe("figure/*/ask")
            peer.subscribe("figure/*/findings")
            peer.watch("figure/*/alive")
            peer.announce("conductor/alive")
            peer.answer_clock()
            peer.serve(self._store.get)

    # ---- what a person, or the stage, wants

    @property
    def conducts(self) -> Conductor:
        """The conductor of this computer; raises `InputError` where it is another one."""
        if self.conductor is None:
            raise InputError(f"{self.settings.conductor} conducts this stage")
        return self.conductor

    def keep(self, contents: Iterable[bytes]) -> None:
        """Store plans and casts, for all figures; raises `OSError`."""
        for content in contents:
            self._store.put(content)

    def offer(self, casts: Sequence[Cast]) -> None:
        """Let all figures make these casts ready when they have nothing else to do."""
        catalogue = packed(Catalogue(casts=tuple(hash_of(packed(cast)) for cast in casts)))
        self._store.put(catalogue)
        self.conducts.catalogue = hash_of(catalogue)

    def stop(self) -> None:
        """Stop all figures; from any computer. Best effort: this is no emergency stop."""
        if self.conductor is None:
            self.player.stop()
            self.log("STOP for all")
        else:
            self.conductor.stop(self._now_ns())
        self._ask(m.Stop())

    def obey(self, operation: m.AnyOperation, origin: str) -> None:
        """Pass on what this computer was asked for; a stop is carried out here, too."""
        match operation:
            case m.Stop() | m.Estop():
                self.stop()
            case m.Go():
                self._ask(operation)
            case s.Trigger() | s.FireCue():
                self._ask(replace(operation, source=operation.source or origin))
            case _:
                raise InputError(f"{operation.op} is for the conductor's computer")

    def _ask(self, operation: m.Go | m.Stop | s.FireCue | s.Trigger) -> None:
        self._ask_count += 1
        ask = Ask(operation=operation, number=self._ask_count, instance=self.instance)
        if self.conductor is None:
            self._asks.extend([ask] * ASK_TIMES)
        else:
            self.cues.append((self.settings.figure, ask))

    # ---- one turn

    def turn(self, timeout_s: float = TURN_S) -> None:
        """Take what arrived, decide, act."""
        for arrival in self.peer.take(timeout_s):
            with contextlib.suppress(InputError):
                self._take(arrival)
        now_ns = self._now_ns()
        if self.conductor is not None:
            self._conduct(self.conductor, now_ns)
        self._play(now_ns)
        self._ask_clock(now_ns)

    def _take(self, arrival: NetworkArrival) -> None:
        key, content = arrival.key, arrival.content
        parts = key.split("/")
        if arrival.what in ("content", "no content"):
            if arrival.what == "content":
                self._keep(content)
        elif arrival.what in ("alive", "gone"):
            self._take_token(parts, is_alive=arrival.what == "alive")
        elif key == "beat":
            if (protocol := other_protocol(content)) is not None:
                self.figure.take_other_protocol(protocol)
            else:
                self._take_beat(parse(ConductorBeat, content), arrival.at_ns)
        elif key == "stop":
            self.figure.take_stop(parse(StopAll, content))
        elif parts[0] == "clock":
            self._take_clock(parse(ClockAnswer, content), arrival.at_ns)
        elif self.conductor is not None and len(parts) == 3:
            self._take_of_figure(self.conductor, parts, content, arrival.at_ns)

    def _take_beat(self, beat: ConductorBeat, at_ns: int) -> None:
        if self.conductor is not None:
            self.conductor.take_beat(beat, at_ns)
        self.figure.take_beat(beat, at_ns)
        if self.figure.beat is not None and self.figure.beat.instance != self._clock_of:
            self._clock_of = self.figure.beat.instance  # Another process, perhaps computer.
            self.estimator = ClockEstimator()
        is_free = not self.figure.player.is_running
        if self._examine is not None and is_free and beat.examines not in (0, self._examined):
            self._examined, self._found = beat.examines, None
            self.log("examines this computer and its servos")
            threading.Thread(target=self._run_examination, daemon=True).start()

    def _run_examination(self) -> None:
        assert self._examine is not None
        self._found = self._examine(self._examined)

    def _take_of_figure(
        self, conductor: Conductor, parts: list[str], content: bytes, at_ns: int
    ) -> None:
        """Take status and wishes; the name in the key is checked by access control."""
        if parts[2] == "status" and (protocol := other_protocol(content)) is not None:
            conductor.take_other_protocol(parts[1], protocol, at_ns)
        elif parts[2] == "status":
            status = parse(FigureStatus, content)
            if status.figure == parts[1]:
                conductor.take_status(status, at_ns)
        elif parts[2] == "findings":
            findings = parse(Findings, content)
            if findings.figure == parts[1]:
                self.findings[parts[1]] = findings
        elif parts[2] == "ask":
            ask = parse(Ask, content)
            if parts[1] not in conductor.figures:
                return
            asked = self._asked.setdefault(parts[1], deque(maxlen=ASKS_MAX))
            if (ask.instance, ask.number) not in asked:
                asked.append((ask.instance, ask.number))
                self._obey(ask, parts[1])

    def _obey(self, ask: Ask, figure: str) -> None:
        told = {**to_builtins(ask.operation), "id": None, "source": None}
        words = [str(value) for value in told.values() if value is not None]
        self.log(f"figure {figure} asks for {' '.join(words)}")
        if isinstance(ask.operation, Examine):
            self._examining = Examining(self, ask.instance, self._now_ns())
            return
        if isinstance(ask.operation, m.Stop):
            self.conducts.stop(self._now_ns())
        self.cues.append((figure, ask))

    def _take_token(self, parts: list[str], *, is_alive: bool) -> None:
        if parts[0] == "conductor":
            if not is_alive:
                self.figure.take_lost()
        elif self.conductor is not None and len(parts) == 3:
            self.conductor.take_alive(parts[1], is_alive=is_alive)

    def _take_clock(self, answer: ClockAnswer, at_ns: int) -> None:
        if answer.instance == self._clock_of:
            self.estimator.add(
                Exchange(answer.asked_ns, answer.received_ns, answer.answered_ns, at_ns)
            )

    def _keep(self, content: bytes) -> None:
        try:
            self._store.put(content)
        except OSError as error:
            self.log(f"a plan cannot be stored: {error}")
            return
        self.figure.take_content(content)

    def _conduct(self, conductor: Conductor, now_ns: int) -> None:
        if now_ns >= self._due_ns["tick"]:
            self._due_ns["tick"] = now_ns + TICK_NS
            for text in conductor.tick(now_ns):
                self.log(text)
        if self._examining is not None and (found := self._examining.turn(now_ns)) is not None:
            self._examining = None
            for one in found:
                self.peer.send(f"examined/{one.figure}", packed(one))
        if conductor.stops != self._stops:
            self._stops, self._stops_left = conductor.stops, STOPS
            self.player.stop()
        if self._stops_left and now_ns >= self._due_ns["stop"]:
            self._stops_left -= 1
            self._due_ns["stop"] = now_ns + STOP_NS
            self.peer.send("stop", packed(conductor.stop_message()))
        state = (
            conductor.wanted,
            conductor.run,
            conductor.legs.newest,
            conductor.cast,
            conductor.epoch,
        )
        is_due = now_ns >= self._due_ns["beat"] or state != self._sent_beat
        if is_due and not conductor.superseded:
            self._due_ns["beat"], self._sent_beat = now_ns + BEAT_NS, state
            self.peer.send("beat", packed(conductor.beat()))

    def _play(self, now_ns: int) -> None:
        figure = self.figure
        while self._verified:
            plan, problem = self._verified.popleft()
            if problem is None:
                figure.take_missing(plan)
            else:
                figure.take_verified(plan, problem)
        figure.take_clock(self.estimator.estimate(now_ns), self.estimator.round_trip_ns)
        figure.take_player(self.player.report(now_ns))
        for action in figure.tick(now_ns):
            self._do(action)
        for text in figure.take_notes():
            self.log(text)
        state = f"{figure.state} {figure.text}"
        if now_ns >= self._due_ns["status"] or state != self._sent_state:
            self._due_ns["status"], self._sent_state = now_ns + STATUS_NS, state
            self.peer.send(f"figure/{figure.name}/status", packed(figure.status(now_ns)))
            if self._found is not None:
                self.peer.send(f"figure/{figure.name}/findings", packed(self._found))
        if self._asks and now_ns >= self._due_ns["ask"]:
            self._due_ns["ask"] = now_ns + STOP_NS
            self.peer.send(f"figure/{figure.name}/ask", packed(self._asks.popleft()))

    def _do(self, action: Action) -> None:
        match action:
            case Fetch():
                content = self._store.get(action.hash)
                if content is None:
                    self.peer.fetch(action.hash)
                else:
                    self.figure.take_content(content)
            case Verify():
                threading.Thread(target=self._verify, args=(action.plan,), daemon=True).start()
            case ArmPlayer():
                self.player.arm(action.plan, action.start_s)
            case FollowLeg():
                self.player.follow(action.instant_ns, action.show_s, action.rate)
            case StopPlayer():
                self.player.stop()

    def _verify(self, plan: str) -> None:
        content = self._store.get(plan)
        self._verified.append((plan, None if content is None else self.player.prepare(content)))

    def _ask_clock(self, now_ns: int) -> None:
        if not self._clock_of or now_ns < self._due_ns["clock"]:
            return
        is_ready = self.estimator.is_ready
        self._due_ns["clock"] = now_ns + (EVERY_NS if is_ready else BURST_NS)
        question = ClockQuestion(asked_ns=self._now_ns())
        self.peer.send(f"figure/{self.settings.figure}/clock", packed(question))

    def close(self) -> None:
        """Stop the player and leave the network; a conductor stops all before."""
        if self.conductor is not None and self.conductor.wanted == "armed":
            self.stop()
            end_ns = self._now_ns() + NS_PER_S
            while self._now_ns() < end_ns:
                self.turn()
        self.player.stop()
        self.player.close()
        self.peer.close()
