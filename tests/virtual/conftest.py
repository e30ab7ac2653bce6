"""Shows played on a simulated bus in virtual time, judged at what its servos received and did."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.playing import api
from lss_motion.playing.run import Observer, Result, perform
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.sim import bus as sim_bus
from lss_motion.sim.faults import FaultKind
from tests.joints import joint
from tests.timed_moves import is_move

ROBOT_FIELDS = ("on_fault", "patience_s", "resume_s")


def make_robot(count=3, *, end="hold", buses=1, baud_bps=19200, **fields) -> Robot:
    """`count` equal joints j0, j1, … with the ids 1, 2, …, dealt to the buses in turn.

    What is no field of the robot is one of all joints. The slow line carries a few joints, and what
    a show costs to play is its questions, which fill the line.
    """
    own = {key: fields.pop(key) for key in ROBOT_FIELDS if key in fields}
    base = joint(**fields)
    joints = {
        f"j{i}": replace(base, name=f"j{i}", servo_id=i + 1, bus=f"bus{i % buses}")
        for i in range(count)
    }
    lines = {
        f"bus{i}": Bus(name=f"bus{i}", port="sim://", baud_bps=baud_bps, firmware=370)
        for i in range(buses)
    }
    return Robot(name="bench", path=None, buses=lines, joints=joints, end=end, **own)


def make_sequence(count=3, duration_s=6.0, *, seed=3, swing_deg=40.0, step_s=(0.9, 1.5), loop=1):
    """All joints swing about at random instants, from rest at 0 to rest at 0."""
    random = np.random.default_rng(seed)
    names = [f"j{i}" for i in range(count)]
    frames, at_s = [Keyframe(deg=dict.fromkeys(names, 0.0), at_s=0.0, label="start")], 0.0
    while at_s < duration_s - 1.5 * step_s[1]:
        at_s = round(at_s + random.uniform(*step_s), 3)
        deg = {name: float(random.uniform(-swing_deg, swing_deg)) for name in names}
        frames.append(Keyframe(deg=deg, at_s=at_s, label=f"at {at_s}"))
    frames.append(Keyframe(deg=dict.fromkeys(names, 0.0), at_s=duration_s, label="end"))
    return Sequence(name="swing", keyframes=tuple(frames), loop=loop)


class Wishes:
    """Controls that act once, as soon as their condition holds: `(condition, action)` in turn."""

    def __init__(self, *wishes):
        self._wishes = list(wishes)
        self.acted_ns = []

    def filenos(self):
        return []

    def act(self, player, now_ns):
        while self._wishes and self._wishes[0][0](player, now_ns):
            _, action = self._wishes.pop(0)
            action(player, now_ns)
            self.acted_ns.append(now_ns)


def in_show(show_s):
    """Return a condition: the show has come to `show_s`."""
    return lambda player, now_ns: player.phase == "playing" and player.show.show_s(now_ns) >= show_s


def in_phase(phase, after_s=0.0):
    return lambda player, now_ns: player.phase == phase and now_ns >= after_s * 1e9


def stop(player, now_ns):
    player.stop(now_ns)


def rate(ratio):
    return lambda player, now_ns: player.set_rate(ratio, now_ns)


@dataclass
class VirtualRun:
    """A run that has ended, and all that is known of it."""

    result: Result
    buses: dict
    events: list
    acted_ns: list
    trajectory: object
    sent: list = field(default_factory=list)

    @property
    def report(self):
        return self.result.report

    @property
    def bus(self):
        return next(iter(self.buses.values()))

    def lines(self, *, after_ns=-1):
        return [line for at_ns, line in self.bus.lines if at_ns > after_ns]

    def moves(self):
        return [line for line in self.lines() if is_move(line)]

    def horn_error_deg(self, from_s=0.0):
        """Return horn minus plan, (instants, joints), at show times from `from_s` on."""
        truth = self.result.truth
        chosen = truth.times_s >= from_s
        assert chosen.any(), "the show got nowhere"
        planned = self.trajectory.sample(truth.times_s[chosen])
        return truth.horn_deg[chosen] - planned

    def speeds(self, from_ns, to_ns):
        """Return speeds and accelerations of all horns, by differences over 5 ms and 20 ms."""
        horn_deg = self.bus.horn_deg(np.arange(from_ns, to_ns, 5_000_000))
        speed = np.diff(horn_deg, axis=0) / 0.005
        smooth = (horn_deg[4:] - horn_deg[:-4]) / 0.02
        return speed, (smooth[4:] - smooth[:-4]) / 0.02


class Sent:
    """A tap that keeps what was sent: `(instant, bus, bytes)`."""

    def __init__(self, sent):
        self._sent = sent

    def sent(self, bus, data, now_ns):
        self._sent.append((now_ns, bus, data))

    def received(self, bus, data, now_ns):
        pass

    def turned(self, now_ns):
        pass

    def happened(self, event, now_ns):
        pass

    def requested(self, request, now_ns):
        pass

    def noted(self, bus, state, now_ns, reason=""):
        pass


class VirtualStage:
    """Plans, compiles and plays; `play` patches only how the simulated buses are made."""

    def __init__(self, monkeypatch):
        self._monkeypatch = monkeypatch

    def compile(self, robot, sequence):
        trajectory = api.plan(sequence, robot)
        return api.compile(trajectory, robot), trajectory

    def play(
        self,
        robot=None,
        sequence=None,
        *,
        wishes=(),
        faults=(),
        physics=None,
        start_deg=None,
        wired=None,
        program=None,
        on_bus=None,
        on_event=None,
        **options,
    ) -> VirtualRun:
        """Play in virtual time. `wired`: the robot that is really there, if it is another."""
        robot = robot or make_robot()
        trajectory = None
        if program is None:
            program, trajectory = self.compile(robot, sequence or make_sequence(len(robot.joints)))
        buses, events, sent = {}, [], []
        make = sim_bus.bus_from_robot

        def made(_, name, *, seed=0, **rest):
            buses[name] = make(
                wired or robot,
                name,
                seed=seed,
                **{**rest, "start_deg": start_deg, "physics": physics, "faults": faults},
            )
            if on_bus is not None:
                on_bus(buses[name])
            return buses[name]

        def note(event):
            events.append(event)
            if on_event is not None:
                on_event(event)

        controls = Wishes(*wishes)
        with self._monkeypatch.context() as patch:
            patch.setattr(sim_bus, "bus_from_robot", made)
            result = perform(
                program,
                robot,
                is_virtual=True,
                trajectory=trajectory,
                faults=[fault for fault in faults if fault.kind is FaultKind.OVERSLEEP],
                observer=Observer(
                    on_event=note, controls=controls, make_tap=lambda start_ns: Sent(sent)
                ),
                **options,
            )
        return VirtualRun(result, buses, events, controls.acted_ns, trajectory, sent)


@pytest.fixture
def stage(monkeypatch):
    return VirtualStage(monkeypatch)


class ShowKit:
    """The words of a test; `conftest` modules cannot be imported by name."""

    robot = staticmethod(make_robot)
    sequence = staticmethod(make_sequence)
    in_show = staticmethod(in_show)
    in_phase = staticmethod(in_phase)
    stop = staticmethod(stop)
    rate = staticmethod(rate)


@pytest.fixture
def kit():
    return ShowKit
