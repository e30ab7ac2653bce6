"""How well many computers keep in step, and what carries them.

Measured: exchanges of zenoh on the loopback; and in the rig (`exchanges.json`), from which the
models of the lines are made. In
virtual time: the same move at the servos of eight hosts, with links and clocks of the model
(`benches.stage_model`) and real players that follow the legs which their figures were told; and a
stage of 200 hosts. `--full` adds an hour with 200 ppm between the clocks.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benches.stage_model import LOOPBACK, STATUS_NS, WIFI, LinkModel, World
from benches.table import Row, core_seconds
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.player.following import SLOW_RATE, Following, FollowRule
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.playing.run import Observer, perform
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.stage.hosts.clocks import EVERY_NS, ClockEstimator, Exchange
from lss_motion.stage.hosts.conductor import ConductorState
from lss_motion.stage.hosts.host import TICK_NS
from lss_motion.stage.hosts.messages import ClockAnswer, ClockQuestion, FigureStatus, packed, parse
from lss_motion.stage.hosts.peer import NetworkSettings
from lss_motion.units import NS_PER_MS, NS_PER_S, NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.stage.hosts.figure import FollowLeg
    from lss_motion.stage.hosts.peer import Peer

HOSTS: Final = 8
ARMED_NS: Final = 20 * NS_PER_S
"""A player is started so long before the first leg."""
PORT: Final = 17_521
EXCHANGES: Final = 600
ANSWERER: Final = """
import sys
from lss_motion.stage.hosts.peer import Peer
from lss_motion.stage.hosts.peer import NetworkSettings
with Peer(NetworkSettings(stage="bench", figure="a", conductor="a", figures=["a", "b"],
                          address=sys.argv[1]), clock_id="0" * 16) as peer:
    peer.answer_clock()
    print("ready", flush=True)
    sys.stdin.read()
"""


def measure_short() -> list[Row]:
    """Return the rows of a minute."""
    return [*exchanged(), *models(), *spread_rows(20.0)]


def measure() -> list[Row]:
    """Return all rows but that of an hour."""
    return [*exchanged(), *models(), *spread_rows(60.0), *many(), *limits()]


def measure_full() -> list[Row]:
    """Return all rows."""
    hour = spread_row("4 hosts, wired, 200 ppm, 1 h", LOOPBACK, 2.0, 3600.0, 4)
    return [*measure(), hour]


def spread_rows(show_s: float) -> list[Row]:
    """Return the rows of eight hosts."""
    links = (("wired", LOOPBACK, 2.0), ("Wi-Fi", WIFI, 5.0))
    return [
        spread_row(f"{HOSTS} hosts, {name}, {show_s:g} s", link, goal_ms, show_s, HOSTS)
        for name, link, goal_ms in links
    ]


# ---- measured


def exchanged() -> list[Row]:
    """Return what exchanges on the loopback take, and what a clock is known to by them."""
    made = exchanges()
    trips_us = sorted(one.round_trip_ns / NS_PER_US for one in made)
    errors_us, bounds_us = [], []
    estimator = ClockEstimator()
    for index, one in enumerate(made):  # Both ends have the same clock: the truth is 0.
        estimator.add(one)
        estimate = estimator.estimate(one.returned_ns)
        if estimate is not None and index % 16 == 0:
            errors_us.append(abs(estimate.offset_ns) / NS_PER_US)
            bounds_us.append(estimate.bound_ns / NS_PER_US)
    p50, p99 = statistics.median(trips_us), trips_us[int(0.99 * len(trips_us))]
    return [
        Row(
            what="network: exchange on the loopback, round trip p50/p99",
            ours=f"{p50:.0f}/{p99:.0f} us",
        ),
        Row(
            what="network: offset error p50/max, bound p50",
            ours=f"{statistics.median(errors_us):.0f}/{max(errors_us):.0f} us, "
            f"{statistics.median(bounds_us):.0f} us",
            is_met=max(errors_us) <= max(bounds_us),
        ),
    ]


def exchanges() -> list[Exchange]:
    """Make exchanges with another process on this computer."""
    from lss_motion.stage.hosts.peer import Peer

    address = f"127.0.0.1:{PORT}"
    other = subprocess.Popen(
        [sys.executable, "-c", ANSWERER, address], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert other.stdout is not None
    other.stdout.readline()
    settings = NetworkSettings(
        stage="bench", figure="b", conductor="a", figures=["a", "b"], address=address
    )
    try:
        with Peer(settings) as peer:
            return exchanged_with(peer, "b", EXCHANGES)
    finally:
        other.kill()
        other.wait()


def exchanged_with(peer: Peer, figure: str, count: int, within_s: float = 60.0) -> list[Exchange]:
    """Ask `count` times for the conductor's clock, as `figure`; return the exchanges."""
    made: list[Exchange] = []
    peer.subscribe(f"clock/{figure}")
    end = time.monotonic() + within_s
    while len(made) < count and time.monotonic() < end:
        question = ClockQuestion(asked_ns=time.monotonic_ns())
        peer.send(f"figure/{figure}/clock", packed(question))
        for arrival in peer.take(0.1):
            got = parse(ClockAnswer, arrival.content)
            if got.asked_ns == question.asked_ns:
                made.append(Exchange(got.asked_ns, got.received_ns, got.answered_ns, arrival.at_ns))
        time.sleep(0.004)
    return made


def fit(trips_ns: Sequence[int]) -> LinkModel:
    """Return a model of one way: the least half of a round trip, and an exponential part above.

    The median of the mean of two of those is 0.839 of one. Not fitted are spikes and losses.
    """
    ways_ns = sorted(trip / 2 for trip in trips_ns)
    base_ns = ways_ns[0]
    return LinkModel(round(base_ns), round((statistics.median(ways_ns) - base_ns) / 0.839))


def models() -> list[Row]:
    """Return the link models beside what was measured in the rig."""
    measured = json.loads((Path(__file__).parent / "exchanges.json").read_text())
    rows = []
    for name, model in (("wired", LOOPBACK), ("wifi", WIFI)):
        made = fit(measured["round_trips_ns"][name])
        near = abs(made.base_ns / model.base_ns - 1.0) < 0.2
        near &= abs(made.jitter_ns / model.jitter_ns - 1.0) < 0.2
        rows.append(
            Row(
                what=f"network: one way in the rig, {name}, fitted",
                ours=f"{made.base_ns / 1e3:.0f} us + exp {made.jitter_ns / 1e3:.0f} us (model: "
                f"{model.base_ns / 1e3:.0f} + {model.jitter_ns / 1e3:.0f})",
                is_met=near,
            )
        )
    return rows


# ---- in virtual time


def spread_row(name: str, link: LinkModel, goal_ms: float, show_s: float, hosts: int) -> Row:
    """Return how far apart the same move arrives at the servos of all hosts."""
    spreads_ms = spreads(link, show_s, hosts)
    p50 = statistics.median(spreads_ms)
    p99 = sorted(spreads_ms)[int(0.99 * len(spreads_ms))]
    return Row(
        what=f"network: same move, {name}",
        ours=f"p50 {p50:.2f}, p99 {p99:.2f}, max {max(spreads_ms):.2f} ms "
        f"({len(spreads_ms)} moves)",
        ratio=p99 / goal_ms,
        target=f"p99 <= {goal_ms:g} ms",
        is_met=p99 <= goal_ms,
    )


def spreads(link: LinkModel, show_s: float, hosts: int, seed: int = 5) -> list[float]:
    """Return for each move how far apart it arrives, in ms of true time."""
    world = World(hosts, link=link, seed=seed, ppm=100.0, show_s=show_s + 5.0)
    world.tick_ns = 10 * NS_PER_MS if show_s < 600.0 else 100 * NS_PER_MS
    for index, host in enumerate(world.hosts.values()):  # The ends of the range, and between.
        host.clock.ppm = 200.0 * (index / (hosts - 1) - 0.5)
    world.go()
    world.run(show_s + 10.0)
    robot = one_joint()
    program = moving(robot, show_s)
    arrivals = []
    for host in world.hosts.values():
        at_own_ns = played(program, robot, host.player.follows)
        arrivals.append([host.clock.true_ns(own_ns) for own_ns in at_own_ns])
    assert len({len(one) for one in arrivals}) == 1, [len(one) for one in arrivals]
    return [(max(each) - min(each)) / NS_PER_MS for each in zip(*arrivals, strict=True)]


def one_joint() -> Robot:
    """Return a robot with one joint."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.yaml"
        path.write_text(
            "robot: one\nbuses: {main: {port: 'sim://', baud_bps: 115200, firmware: 370}}\n"
            "joints: {j: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, "
            "accel_max_deg_s2: 600}}\n"
        )
        return load_robot(path)


def moving(robot: Robot, show_s: float) -> Program:
    """Return a show that moves its joint now and then, as a figure does."""
    every_s = 1.0 if show_s < 600.0 else 15.0
    keys = [
        {"at_s": index * every_s, "deg": {"j": 30.0 * (index % 2)}, "hold_s": 0.3}
        for index in range(int(show_s / every_s))
    ]
    sequence = load_sequence({"sequence": "model", "keyframes": keys}, robot)
    return compile_program(plan(sequence, robot), robot)


class Told:
    """Controls that tell a player what its figure was told, at the same instants."""

    def __init__(self, follows: list[tuple[int, FollowLeg]], began_ns: int) -> None:
        self._follows = [(at - began_ns, follow) for at, follow in follows]
        self._began_ns = began_ns
        self._index = 0
        self.following = Following(
            FollowRule(freewheel_s=3.0, lost="hold", slowest=SLOW_RATE, goes_to_it=True)
        )

    def filenos(self) -> list[int]:
        return []

    def act(self, player: Player, now_ns: int) -> None:
        while self._index < len(self._follows) and self._follows[self._index][0] <= now_ns:
            follow = self._follows[self._index][1]
            self._index += 1
            leg = LeaderPosition(follow.instant_ns - self._began_ns, follow.show_s, follow.rate)
            self.following.lead(leg, now_ns)
        self.following.turn(player, now_ns)


def played(program: Program, robot: Robot, follows: list[tuple[int, FollowLeg]]) -> list[int]:
    """Play it in virtual time; return at which own instants its moves reached the servo."""
    began_ns = follows[0][1].instant_ns - ARMED_NS
    told = Told(follows, began_ns)
    result = perform(
        program,
        robot,
        is_virtual=True,
        has_feedback=False,
        is_forced=True,
        observer=Observer(controls=told),
    )
    assert result.error is None, result.error
    lines = result.simulated["main"].received[0]
    moves = [
        at for at, line in lines if b"D" in line and b"T" in line and at >= ARMED_NS - NS_PER_S
    ]
    return [at + began_ns for at in moves]


def limits(hosts: int = 200) -> list[Row]:
    """Return what a conductor's computer does for so many hosts, and what gives out first."""
    world = World(hosts, show_s=60.0)
    status = packed(world.hosts["f1"].figure.status(0))
    question = packed(ClockQuestion(asked_ns=1))
    answer = ClockAnswer(asked_ns=1, received_ns=2, answered_ns=3, instance="0" * 16)
    for host in world.hosts.values():
        world.conductor.take_status(host.figure.status(0), 0)
    count = 300

    def take() -> None:
        for _ in range(count):
            world.conductor.take_status(parse(FigureStatus, status), 0)

    def answered() -> None:
        for _ in range(count):
            parse(ClockQuestion, question, 200)
            packed(answer)

    def ticks() -> None:
        for _ in range(count):
            world.conductor.tick(NS_PER_S)

    status_s, clock_s, tick_s = (core_seconds(one) / count for one in (take, answered, ticks))
    statuses_hz = hosts * NS_PER_S / STATUS_NS
    clocks_hz = hosts * NS_PER_S / EVERY_NS
    shares = {
        "states": statuses_hz * status_s,
        "clock answers": clocks_hz * clock_s,
        "looking after the figures": tick_s * NS_PER_S / TICK_NS,
    }
    used = sum(shares.values())
    text = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
    return [
        Row(
            what=f"network: {hosts} hosts, Python at the conductor (measured parts)",
            ours=f"{100 * used:.0f} % of a core: {text}",
        )
    ]


def many() -> list[Row]:
    """Return what 200 hosts of 18 joints need, by the model."""
    plan_bytes, verify_s = ten_minutes()
    world = World(
        200, link=LOOPBACK, seed=3, show_s=60.0, plan_bytes=plan_bytes, line_bytes_s=12.5e6
    )
    world.tick_ns = 50 * NS_PER_MS
    world.verify_ns = round(verify_s * NS_PER_S)
    while world.conductor.state is not ConductorState.ARMING:
        if world.conductor.state in (ConductorState.CONNECTING, ConductorState.STANDING):
            world.play()  # It was refused, as plans were fetched for too long.
        world.run(0.1)
    ready_s = world.now_ns / NS_PER_S
    world.wait(ConductorState.PLAYING)
    world.run(5.0)
    before = (world.from_conductor_bytes, world.to_conductor_bytes)
    world.run(5.0)
    sent = (world.from_conductor_bytes - before[0]) / 5e3
    got = (world.to_conductor_bytes - before[1]) / 5e3
    at_ns = world.spread_ns(5.0)
    return [
        Row(
            what="network: plan of 18 joints for 10 min, verified",
            ours=f"{plan_bytes / 1e6:.1f} MB, {verify_s:.1f} s of a core",
        ),
        Row(
            what="network: 200 hosts, 3,600 joints, 100 Mbit/s, plan to all ready (model)",
            ours=f"{ready_s:.0f} s",
        ),
        Row(
            what="network: 200 hosts, at the conductor, out/in (model)",
            ours=f"{sent:.0f}/{got:.0f} kB/s",
        ),
        Row(
            what="network: 200 hosts, what gives out first (model)",
            ours=f"the line while plans are fetched: {200 * plan_bytes / 1e6:.0f} MB; then it "
            f"carries {800 * (sent + got) / 100e3:.0f} %",
        ),
        Row(
            what="network: 200 hosts, spread of the start, wired (model)",
            ours=f"{(max(at_ns) - min(at_ns)) / NS_PER_MS:.2f} ms",
        ),
    ]


def ten_minutes() -> tuple[int, float]:
    """Return the bytes of a plan of ten minutes for 18 joints, and what verifying it takes."""
    from lss_motion.stage.hosts.plans import read_plan

    robot, program = eighteen(600.0)
    content = program.to_text().encode()
    seconds = core_seconds(lambda: read_plan(content, robot))
    return len(content), seconds


def eighteen(show_s: float, folder: Path | None = None) -> tuple[Robot, Program]:
    """Return a robot of 18 joints, and a show in which each moves every second or two."""
    import tempfile

    joints = ", ".join(f"j{n}: {{id: {n + 1}, range_deg: [-90, 90]}}" for n in range(18))
    with tempfile.TemporaryDirectory() as made:
        path = Path(folder or made) / "robot.yaml"
        path.write_text(
            "robot: many\nbuses: {main: {port: 'sim://', baud_bps: 115200, firmware: 370}}\n"
            "defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}\n"
            f"joints: {{{joints}}}\n"
        )
        robot = load_robot(path)
    keys = [
        {"at_s": 1.5 * k, "deg": {f"j{n}": 25.0 * ((k + n) % 3 - 1) for n in range(18)}}
        for k in range(int(show_s / 1.5))
    ]
    sequence = load_sequence({"sequence": "long", "keyframes": keys}, robot)
    return robot, compile_program(plan(sequence, robot), robot)
