"""Shows that a client steers over a socketpair, in virtual time: judged by bytes and horns."""

from __future__ import annotations

import contextlib
import itertools
import socket

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.playing.player.following import FollowRule
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.job import Job, play
from lss_motion.playing.remote.message import Telemetry
from lss_motion.playing.remote.operator_end import Operator
from lss_motion.playing.remote.player_end import LossRule, Steering
from lss_motion.playing.run import Observer, perform
from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError
from tests.timed_moves import is_move
from tests.virtual.conftest import make_robot, make_sequence

S = 1_000_000_000


class SteeringClient:
    """A client whose `act` is called on each turn, so that virtual time is its time, too."""

    def __init__(self, rule=None, script=()):
        self.end, other = socket.socketpair()
        for one in (self.end, other):
            one.setblocking(False)
        self.link, self.reads = MessagePipe(self.end), True
        self.steering = Steering(Operator(MessagePipe(other)), rule)
        self.script = list(script)
        self.events, self.telemetry, self.outcome = [], [], None
        act = self.steering.act

        def act_after_script(player, now_ns):
            while self.script and self.script[0][0](player, now_ns):
                self.script.pop(0)[1](self)
            act(player, now_ns)

        self.steering.act = act_after_script

    def close(self):
        self.link.close()
        self.steering.operator.link.close()

    def send(self, operation):
        self.link.send(Kind.OPERATION, operation.to_json())

    def read(self):
        with contextlib.suppress(PipeClosedError, OSError):
            while self.reads and (got := self.link.receive()):
                for kind, content in got:
                    if kind is Kind.TELEMETRY:
                        self.telemetry.append(Telemetry.from_bytes(content))
                    else:
                        self.events.append(m.parse_event(content))

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]


def sends(operation):
    return lambda client: client.send(operation)


def at(show_s):
    return lambda player, now_ns: player.phase == "playing" and player.show.show_s(now_ns) >= show_s


@pytest.fixture(scope="module")
def show():
    from lss_motion.playing import api

    robot = make_robot(2)
    trajectory = api.plan(make_sequence(2, 4.0, step_s=(0.7, 1.0)), robot)
    return robot, api.compile(trajectory, robot), trajectory


def run(show, client, **options):
    """Play `show` with `client`; return the result and the lines that the servos received."""
    robot, program, trajectory = show
    on_turn = client.steering.on_turn

    def turn(player, now_ns):
        on_turn(player, now_ns)
        client.read()

    client.steering.on_turn = turn
    result = {}
    import lss_motion.playing.run as module

    real = module.perform

    def kept(*arguments, **more):
        result["of"] = real(*arguments, **more)
        return result["of"]

    module.perform = kept
    try:
        job = Job(
            shows=program,
            robot=robot,
            trajectory=trajectory,
            options={"is_virtual": True, **options},
        )
        client.outcome = play(job, client.steering)
    finally:
        module.perform = real
        client.read()
        client.close()
    return result["of"]


def lines(result):
    return next(iter(result.simulated.values())).lines


@pytest.fixture(scope="module")
def alone(show):
    robot, program, _ = show
    return lines(perform(program, robot, is_virtual=True, observer=Observer()))


def test_a_client_that_watches_changes_no_byte_and_sees_the_show(show, alone):
    client = SteeringClient()
    assert lines(run(show, client)) == alone
    assert isinstance(client.events[0], m.Started)
    assert client.events[0].joints == ("j0", "j1")
    assert [e.phase for e in client.of(m.PhaseChanged)][-3:] == ["playing", "restoring", "done"]
    assert client.events[-1].outcome == "finished"
    assert client.events[-1].report["played_s"] == pytest.approx(4.0)
    # It can see the plan, and servos that follow it.
    angles = np.array([t.angles_deg for t in client.telemetry])
    times_s = np.array([t.show_s for t in client.telemetry])
    assert np.diff(times_s).max() < 0.1
    planned = show[2].sample(times_s.clip(0.0, 4.0))
    assert np.abs(angles[:, :, 0] - planned).max() < 0.5
    assert np.nanmax(np.abs(angles[:, :, 1] - planned)) < 1.0
    assert set(client.of(m.Health)[-1].joints) == {"j0", "j1"}


def test_a_client_that_floods_and_never_reads_delays_no_byte(show, alone):
    client = SteeringClient()
    client.reads = False
    flood = b"".join(
        k.value + len(c).to_bytes(4, "little") + c
        for k, c in [
            (Kind.OPERATION, b'{"op": "beat"}'),
            (Kind.OPERATION, b"x" * 3000),
            (Kind.OPERATION, b'{"op": "rate", "ratio": 1.0}'),
            (Kind.TELEMETRY, b"?"),
        ]
    )

    def pour(player, now_ns):
        with contextlib.suppress(BlockingIOError):
            for _ in range(5):
                client.end.send(flood)  # What is cut breaks the link: its end is a lost operator.
        return False

    client.script = [(pour, None)]
    client.steering._rule = LossRule("go_on")
    assert lines(run(show, client)) == alone


def test_pause_and_resume_stand_and_go_on_along_the_path(show):
    client = SteeringClient(
        script=[
            (at(1.2), sends(m.Pause(id=1))),
            (lambda player, now_ns: player.is_paused, lambda c: None),
        ]
    )
    resumed = []

    def is_standing(player, now_ns):
        resumed.append(now_ns)
        return player.show.is_standing(now_ns)

    client.script.append((is_standing, sends(m.Resume(id=2))))
    result = run(show, client)
    assert client.outcome.report.outcome == "finished"
    assert [e.id for e in client.of(m.Accepted)] == [1, 2]
    assert [e.is_paused for e in client.of(m.RateChanged)] == [True, False]
    error = result.truth.horn_deg - show[2].sample(result.truth.times_s)
    assert np.abs(error).max() < 2.0


def test_wishes_for_a_rate_as_fast_as_they_come_are_few_changes(show):
    client = SteeringClient(script=[(at(1.0), lambda c: None)])
    ratios = iter(np.linspace(0.6, 0.9, 600))

    def wish(player, now_ns):
        if (ratio := next(ratios, None)) is not None:
            client.send(m.Rate(ratio=float(ratio)))
        return False

    client.script.append((wish, None))
    result = run(show, client)
    assert client.outcome.report.outcome == "finished"
    times = len(client.of(m.RateChanged))
    assert 1 <= times <= 10 * client.outcome.report.run_s
    error = result.truth.horn_deg - show[2].sample(result.truth.times_s)
    assert np.abs(error).max() < 2.0


def last_line(result):
    return lines(result)[-1][1]


def test_stop_by_two_ways_at_once_brakes_and_gives_settings_back(show):
    client = SteeringClient(
        script=[(at(1.2), lambda c: (c.send(m.Stop(id=1)), c.send(m.Stop(id=2))))]
    )
    result = run(show, client)
    assert client.outcome.report.outcome == "stopped"
    assert not any("not given back" in text for text in client.outcome.report.warnings)
    assert 1.2 < client.outcome.report.played_s < 2.2
    assert last_line(result) == b"#254H\r"
    late = SteeringClient(
        script=[(at(1.2), lambda c: (c.send(m.Stop(id=1)), c.send(m.Pause(id=3))))]
    )
    run(show, late)
    assert [e.id for e in late.of(m.Refused)] == [3]


def test_an_estop_overtakes_what_arrived_before_it(show):
    def together(client):
        client.send(m.Rate(id=1, ratio=0.5))
        client.send(m.Stop(id=2))
        client.send(m.Estop(id=3))

    client = SteeringClient(script=[(at(1.2), together)])
    result = run(show, client)
    assert last_line(result) == b"#254H\r"
    # A stop would have given back the settings.
    assert not any(b"EM1" in line for _, line in lines(result)[-8:])
    assert client.of(m.Accepted)[0].id == 3


@pytest.mark.parametrize(
    ("rule", "outcome"), [("stop", "stopped"), ("hold", "stopped"), ("go_on", "finished")]
)
def test_a_client_that_is_gone_leaves_a_safe_robot(show, rule, outcome):
    client = SteeringClient(LossRule(rule), [(at(1.2), lambda c: c.end.close())])
    result = run(show, client)
    assert client.outcome.report.outcome == outcome
    assert last_line(result) == b"#254H\r"


def test_a_silent_client_is_lost_and_may_come_back(show):
    client = SteeringClient(LossRule("hold", silent_s=0.5))
    paused = []

    def beat(player, now_ns):
        if player.phase == "playing" and player.show.show_s(now_ns) > 1.2 and len(paused) < 40:
            paused.append(player.is_paused)
        else:
            client.send(m.Beat())
        if len(paused) == 40 and player.is_paused:
            client.send(m.Resume())
        return False

    client.script = [(beat, None)]
    run(show, client)
    assert client.outcome.report.outcome == "finished"


def test_a_client_sends_the_show_elsewhere(show):
    client = SteeringClient(
        script=[
            (at(1.2), lambda c: (c.send(m.Seek(id=1, to="start")), c.send(m.Seek(id=2, to=9.0)))),
        ]
    )
    run(show, client)
    assert client.outcome.report.outcome == "finished"
    assert [e.id for e in client.of(m.Accepted)] == [1]
    assert "ends at 4.000 s" in client.of(m.Refused)[0].text
    times_s = [t.show_s for t in client.telemetry]
    assert sum(b < a - 0.5 for a, b in itertools.pairwise(times_s)) == 1


def test_nothing_moves_before_go(show):
    ready = lambda player, now_ns: player.phase == "ready"  # noqa: E731
    client = SteeringClient(
        script=[(ready, sends(m.Rate(id=1, ratio=2 / 3))), (ready, sends(m.Go(id=2)))]
    )
    run(show, client, must_ask=True)
    assert client.outcome.report.outcome == "finished"
    gone = SteeringClient(LossRule("go_on"), [(ready, lambda c: c.end.close())])
    result = run(show, gone, must_ask=True)
    assert gone.outcome.report.outcome == "stopped"
    assert not any(is_move(line) for _, line in lines(result))


def test_what_cannot_begin_ends_with_its_error(show):
    program, other = show[1], make_robot(1)
    client = SteeringClient()
    client.outcome = play(
        Job(shows=program, robot=other, options={"is_virtual": True}), client.steering
    )
    client.read()
    client.close()
    assert isinstance(client.outcome.error, InputError)
    assert "'j1'" in client.events[-1].error


class ConductorStub(Operator):
    """Tells a player where a show is that plays already: at 0 s at the instant 3 s."""

    def take(self, now_ns):
        super().take(now_ns)
        return [m.Follow(id=1, instant_ns=now_ns, show_s=now_ns / S - 3.0, rate=1.0)]


def test_a_player_that_comes_back_stands_where_the_show_will_be_and_gains_speed_by_a_ramp(
    monkeypatch,
):
    import lss_motion.playing.run as module
    from lss_motion.playing import api

    robot = make_robot(2, baud_bps=115200)
    sequence = make_sequence(2, 12.0, step_s=(0.6, 0.9), swing_deg=60.0)
    program = api.compile(api.plan(sequence, robot), robot)
    real, results = module.perform, []
    monkeypatch.setattr(
        module, "perform", lambda *given, **more: results.append(real(*given, **more)) or results[0]
    )
    end, other = socket.socketpair()
    for one in (end, other):
        one.setblocking(False)
    operator = ConductorStub(MessagePipe(other))
    job = Job(
        shows=program,
        robot=robot,
        follow=FollowRule(lost="hold"),
        options={"is_virtual": True, "start_s": 5.3},
    )
    outcome = job.run(operator)
    end.close()
    operator.link.close()
    assert outcome.report.outcome == "finished"
    (bus,) = results[0].simulated.values()
    at_s = np.array([ns / S for ns, line in bus.lines if is_move(line)])
    assert at_s[-1] == pytest.approx(15.0, abs=1.0), "in step at the end"
    stood_s = max(np.diff(at_s[at_s < 9.0]))
    assert stood_s > 1.5, "it waits for the show at its place"
    horn_deg = bus.horn_deg(np.arange(0, round(15.5 * S), S // 200))
    smooth = (horn_deg[4:] - horn_deg[:-4]) / 0.02
    accel = (smooth[4:] - smooth[:-4]) / 0.02
    limits = [joint.accel_max_deg_s2 for joint in robot.joints.values()]
    assert (np.abs(accel).max(axis=0) <= 1.02 * np.array(limits)).all()
