"""Targets that come while a robot moves, good and hostile ones, judged at servos and horns."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.targets import TargetLimiter, TargetRule, live_program
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s
from tests.virtual.conftest import make_robot
from tools.campaign.allowances import ACCEL_EXCESS, RANGE_EXCESS_DEG, SPEED_EXCESS, STEP_NS, WINDOW


class Noting:
    """A player that lets `sent` have the moves by which it is extended: servo id, time, angle."""

    def __init__(self, player, sent):
        self._player, self._sent = player, sent

    def __getattr__(self, name):
        return getattr(self._player, name)

    def extend(self, extension, now_ns):
        for move in extension.moves:
            per_deg = self._player.show.find_state((move.bus, move.servo_id)).limits.wire_per_deg
            found = self._sent.setdefault(move.servo_id, [])
            found.append((now_ns, move.target_wire / per_deg))
        return self._player.extend(extension, now_ns)


class Followed:
    """One run in which `script` gives targets: `(time since the show began, targets)` in turn.

    Targets that are refused are counted. The run is stopped `quiet_s` after the last of them.
    """

    def __init__(self, robot, script, *, rule=None, quiet_s=1.5, start_deg=0.0, seed=0):
        self.script, self.quiet_ns = list(script), ns_from_s(quiet_s)
        self.taken, self.refused, self.began_ns, self.end_ns = [], 0, None, 0
        self.sent, self.early_ns = {}, dict.fromkeys(robot.joints, 0)
        program = live_program(robot, dict.fromkeys(robot.joints, start_deg))
        self.robot, self.limiter = robot, TargetLimiter(program, robot, rule)
        self.rule = rule or TargetRule()
        self.result = perform(
            program,
            robot,
            is_virtual=True,
            is_open=True,
            seed=seed,
            observer=Observer(controls=self),
        )
        assert self.result.error is None
        self.end_ns = self.end_ns or self.began_ns
        for bus in self.result.simulated.values():
            bus.advance(self.end_ns + 2 * NS_PER_S)

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if self.began_ns is None and player.phase is Phase.SHOW and player.show is not None:
            self.began_ns = now_ns
        if self.began_ns is not None:
            while self.script and now_ns >= self.began_ns + self.script[0][0]:
                self._set(self.script.pop(0)[1], now_ns)
            last_ns = self.taken[-1][0] if self.taken else self.began_ns
            if self.script:
                player.wake_at(self.began_ns + self.script[0][0])
            elif not self.end_ns and now_ns >= last_ns + self.quiet_ns:
                self.end_ns = now_ns
                self.limiter.brake(player, now_ns)
                player.stop(now_ns)
            for name, state in player.show.joint_states.items():
                self.early_ns[name] = min(self.early_ns[name], ns_from_s(state.early_s))
        self.limiter.act(Noting(player, self.sent), now_ns)

    def _set(self, deg, now_ns):
        try:
            self.limiter.set(deg, now_ns)
        except InputError:
            self.refused += 1
        else:
            self.taken.append((now_ns, deg))

    def horns(self):
        """Return the joint angles of the horns from the begin on, `STEP_NS` apart, by name."""
        times_ns = np.arange(self.began_ns, self.end_ns + NS_PER_S, STEP_NS)
        found = {}
        for name, bus in self.result.simulated.items():
            servo_deg = bus.horn_deg(times_ns)
            joints = [joint for joint in self.robot.joints.values() if joint.bus == name]
            for column, joint in enumerate(joints):
                found[joint.name] = joint.direction * (servo_deg[:, column] - joint.zero_deg)
        return times_ns, found

    def broken(self):
        """Return every limit that a horn broke, as texts."""
        texts = []
        _, horns = self.horns()
        for name, horn in horns.items():
            joint = self.robot.joints[name]
            if horn.min() < joint.position_min_deg - RANGE_EXCESS_DEG:
                texts.append(f"{name} came to {horn.min():.2f} deg")
            if horn.max() > joint.position_max_deg + RANGE_EXCESS_DEG:
                texts.append(f"{name} came to {horn.max():.2f} deg")
            span_s = WINDOW * STEP_NS / NS_PER_S
            speed = (horn[WINDOW:] - horn[:-WINDOW]) / span_s
            most = SPEED_EXCESS * joint.speed_max_deg_s
            if joint.drive == "stepped":  # From one pulse to the next, and one unit.
                most += joint.unit_deg / span_s + joint.speed_max_deg_s
            if np.abs(speed).max() > most:
                texts.append(f"{name} came to {np.abs(speed).max():.1f} deg/s of {most:.1f}")
            accel = np.abs(speed[WINDOW:] - speed[:-WINDOW]).max() / span_s
            if joint.drive != "stepped" and accel > ACCEL_EXCESS * joint.accel_max_deg_s2:
                texts.append(f"{name} came to {accel:.0f} deg/s2 of {joint.accel_max_deg_s2:.0f}")
        return texts

    def moves(self, name):
        """Return when the servo of a joint received its moves since the begin."""
        joint = self.robot.joints[name]
        head = f"#{joint.servo_id}D".encode()
        lines = self.result.simulated[joint.bus].lines
        return [at_ns for at_ns, line in lines if line.startswith(head) and at_ns > self.began_ns]

    def late(self):
        """Return the targets that a servo received later than the stated bound, as texts.

        The bound is to the horn; what it allows to servo and horn is taken off, and a servo that
        lags less than assumed gets its moves later by as much. A target that another one takes back
        in time needs no move.
        """
        texts = []
        for name, joint in self.robot.joints.items():
            bound_ns = ns_from_s(self.limiter.latency_s(name))
            bound_ns -= ns_from_s(joint.response.loop_s + joint.response.lag_s)
            low_deg, high_deg = joint.position_min_deg, joint.position_max_deg
            wanted = [
                (at_ns, joint.servo_deg(min(max(float(deg[name]), low_deg), high_deg)))
                for at_ns, deg in self.taken
                if name in deg
            ]
            received, sent = self.moves(name), self.sent.get(joint.servo_id, [])
            bound_ns -= min(0, self.early_ns[name])
            for index, (at_ns, _) in enumerate(wanted):
                before = [deg for sent_ns, deg in sent if sent_ns <= at_ns]
                stood_deg = before[-1] if before else joint.servo_deg(0.0)
                after = [got_ns for got_ns in received if at_ns < got_ns <= at_ns + bound_ns]
                soon = [deg for t_ns, deg in wanted[index:] if t_ns <= at_ns + bound_ns]
                is_back = any(abs(deg - stood_deg) <= joint.unit_deg for deg in soon)
                if not after and not is_back and at_ns + bound_ns < self.end_ns:
                    texts.append(f"{name}: target at {(at_ns - self.began_ns) / 1e9:.3f} s")
        return texts


def hostile_robot(random):
    """A robot of up to four joints of all kinds: zero, sense, limits, one of them without T."""
    count = random.randint(1, 4)
    robot = make_robot(count, baud_bps=random.choice((38400, 115200)))
    joints = {}
    for name, joint in robot.joints.items():
        joints[name] = replace(
            joint,
            position_min_deg=-random.uniform(10.0, 80.0),
            position_max_deg=random.uniform(10.0, 80.0),
            speed_max_deg_s=random.choice((30.0, 90.0, 180.0, 300.0)),
            accel_max_deg_s2=random.choice((150.0, 600.0, 1000.0)),
            zero_deg=random.choice((0.0, 5.0, -8.3)),
            direction=random.choice((1, -1)),
        )
        if random.random() < 0.2:
            io2 = {"drive": "stepped", "model": SERVO_MODELS["LSS-2IO"], "servo_id": 209}
            if all(one.drive != "stepped" for one in joints.values()):
                joints[name] = replace(joints[name], zero_deg=0.0, **io2)
    return replace(robot, joints=joints)


def jumps(random, some):
    for _ in range(random.randint(1, 6)):
        yield {name: random.choice((-1e9, -200.0, 0.0, 45.0, 1e300)) for name in some}
        yield random.choice((0.001, 0.02, 0.11, 0.3))


def flood(random, some):
    for _ in range(400):
        yield {name: random.uniform(-90.0, 90.0) for name in some}
        yield 0.0002


def gap(random, _):
    yield random.choice((0.19, 0.21, 0.6, 1.2))


def sweep(random, some):
    rate_hz, hz = random.choice((24, 50, 120)), random.uniform(0.2, 5.0)
    for step in range(rate_hz):
        yield dict.fromkeys(some, 60.0 * math.sin(2.0 * math.pi * hz * step / rate_hz))
        yield 1.0 / rate_hz


def noise(random, some):
    for _ in range(30):
        yield {name: random.gauss(0.0, 0.3) for name in some}
        yield 0.015


def nonsense(_, some):
    for value in (math.nan, math.inf, -math.inf, "fast", None):
        yield {some[0]: value}
    yield {"no_joint": 3.0}
    yield {some[0]: 10.0, "no_joint": 3.0}


def hostile_script(random, names):
    """Return targets of all kinds, and of what is none, with their instants."""
    at_ns, script = 0, []
    for _ in range(random.randint(3, 7)):
        kind = random.choice((jumps, flood, gap, sweep, noise, nonsense))
        for one in kind(random, random.sample(names, random.randint(1, len(names)))):
            if isinstance(one, float):
                at_ns += ns_from_s(one)
            else:
                script.append((at_ns, one))
    return script


def followed(seed):
    random = Random(seed)
    robot = hostile_robot(random)
    rule = TargetRule(smooth_s=random.choice((0.0, 0.03, 0.1, 0.5)))
    script = hostile_script(random, list(robot.joints))
    return Followed(robot, script, rule=rule, seed=seed)


def judged(seed):
    """Return what a run broke; the bound on latency is one without faults."""
    run = followed(seed)
    assert run.result.report.outcome == "stopped"
    return [*run.broken(), *([] if run.result.player.faults else run.late())]


@pytest.mark.parametrize("seed", [*range(12), 4454])
def test_hostile_targets_break_no_limit_and_none_is_late(seed):
    assert judged(seed) == []


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_many_seeds_of_hostile_targets_break_no_limit(block):
    texts = {seed: judged(seed) for seed in range(1000 + 100 * block, 1100 + 100 * block)}
    assert {seed: text for seed, text in texts.items() if text} == {}


@pytest.mark.parametrize("idle_s", [0.2, 0.5])
def test_without_targets_all_joints_brake_and_hold_until_the_next(idle_s):
    robot = make_robot(2, baud_bps=115200)
    script = [(0, {"j0": 80.0, "j1": -5.0}), (2 * NS_PER_S, {"j0": -80.0})]
    run = Followed(robot, script, rule=TargetRule(idle_s=idle_s))
    times_ns, horns = run.horns()
    joint, speeds = robot.joints["j0"], np.abs(np.gradient(horns["j0"])) * NS_PER_S / STEP_NS
    brakes_s = idle_s + run.limiter.latency_s("j0")
    rests_s = brakes_s + joint.speed_max_deg_s / joint.accel_max_deg_s2 + 0.05
    for at_ns, _ in run.taken:
        since_s = (times_ns - at_ns) / NS_PER_S
        assert speeds[(since_s > idle_s - 0.05) & (since_s < idle_s)].min() > 30.0
        assert speeds[(since_s > rests_s) & (since_s < 1.4)].max() < 1.0
    assert 20.0 < horns["j0"].max() < 80.0 + RANGE_EXCESS_DEG
    assert -80.0 < horns["j0"][-1] < horns["j0"].max() - 20.0
    assert run.broken() == []


def test_without_a_limit_of_time_the_last_targets_are_reached():
    robot = make_robot(2, baud_bps=115200)
    script = [(0, {"j0": 80.0}), (10 * NS_PER_MS, {"j1": -500.0})]
    run = Followed(robot, script, rule=TargetRule(idle_s=None), quiet_s=2.5)
    _, horns = run.horns()
    assert horns["j0"][-1] == pytest.approx(80.0, abs=0.3)
    assert horns["j1"][-1] == pytest.approx(-90.0, abs=0.3)


def test_a_target_that_does_not_change_is_sent_once():
    run = Followed(make_robot(1), [(20 * NS_PER_MS * n, {"j0": 10.0}) for n in range(100)])
    assert len(run.sent[1]) == 1


def test_targets_that_come_one_after_the_other_become_one_motion():
    """A joint that is led at 40 deg/s by 30 targets a second turns at about this speed."""
    script = [(round(n * NS_PER_S / 30), {"j0": -40.0 + 4.0 / 3.0 * n}) for n in range(60)]
    run = Followed(make_robot(1, baud_bps=115200), script, start_deg=-40.0)
    times_ns, horns = run.horns()
    since_s = (times_ns - run.began_ns) / NS_PER_S
    speeds = np.gradient(horns["j0"])[(since_s > 0.6) & (since_s < 1.9)] * NS_PER_S / STEP_NS
    assert speeds.min() > 30.0
    assert speeds.max() < 50.0


def test_what_is_no_target_is_refused_and_changes_nothing():
    script = [
        (0, {"j0": math.nan}),
        (0, {"j0": 20.0, "elbo": 3.0}),
        (0, {"j0": "fast"}),
        (0, {"j0": None}),
        (0, {"j0": -math.inf}),
    ]
    run = Followed(make_robot(1), script)
    assert run.refused == 5
    assert run.sent == {}


def test_a_servo_that_begins_each_move_at_rest_gets_the_next_one_at_rest():
    robot = make_robot(1, baud_bps=115200)
    slow = replace(robot.joints["j0"].response, retarget="from_rest")
    robot = replace(robot, joints={"j0": replace(robot.joints["j0"], response=slow)})
    script = [(50 * NS_PER_MS * n, {"j0": 1.0 * n}) for n in range(40)]
    run = Followed(robot, script, rule=TargetRule(idle_s=None), quiet_s=3.0)
    assert run.horns()[1]["j0"][-1] == pytest.approx(39.0, abs=0.5)
    assert len(run.sent[1]) < 20


@pytest.mark.parametrize("fields", [{"idle_s": 0.0}, {"idle_s": math.nan}, {"smooth_s": -1.0}])
def test_a_rule_of_impossible_times_is_refused(fields):
    with pytest.raises(InputError, match=r"_s is"):
        TargetRule(**fields)


def test_a_servo_without_ramps_gentle_enough_is_refused():
    robot = make_robot(1, accel_max_deg_s2=1.0)
    with pytest.raises(InputError, match="the gentlest ramp"):
        live_program(robot, {"j0": 0.0})
