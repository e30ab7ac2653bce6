"""Shows that follow a leader, judged at the horns."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning import shows
from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.player.following import SLOW_RATE, Following, FollowingStep, FollowRule
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.playing.remote.schema import Follow
from lss_motion.stage.timecode.source import FollowControls

S = 1_000_000_000
LEG_NS = S // 10


class Leader:
    """Gives a leg ten times a second: `at(seconds)` is its show time and rate, or None."""

    def __init__(self, at, rule=None, acts=()):
        self.at, self.following, self.acts = at, Following(rule), list(acts)
        self.texts, self.notes, self.course, self.steps = [], [], [], []
        self.start_ns = self.next_ns = None
        self.following.note_request = lambda asked, now_ns: self.notes.append((now_ns, asked.name))

    def turn(self, player, now_ns):
        """A condition of the test stage that is called each turn and is never met."""
        if self.start_ns is None:
            self.start_ns = self.next_ns = now_ns
        seconds = (now_ns - self.start_ns) / S
        while self.acts and self.acts[0][0] <= seconds:
            self.acts.pop(0)[1](self, player, now_ns)
        while self.next_ns <= now_ns:
            led = self.at((self.next_ns - self.start_ns) / S)
            if led is not None:
                self.following.lead(LeaderPosition(self.next_ns, *led), now_ns)
            self.next_ns += LEG_NS
        self.following.turn(player, now_ns)
        self.texts += self.following.take_texts()
        led = self.at(seconds)
        if led is not None and player.show is not None and player.phase is Phase.SHOW:
            self.course.append((seconds, player.show.show_s(now_ns), led[0]))
            self.steps.append(self.following.step)
        return False

    def play(self, stage, robot, show=None, **options):
        return stage.play(robot, show, wishes=[(self.turn, None)], **options)

    def off_s(self, from_s=0.0, to_s=1e9):
        """How far the show was behind its leader, while it was in step."""
        return np.array(
            [
                led_s - show_s
                for (at_s, show_s, led_s), step in zip(self.course, self.steps, strict=True)
                if from_s <= at_s < to_s and step is FollowingStep.RUNNING
            ]
        )


def assert_limits_hold(played, robot):
    """Judge speed and acceleration of every horn over the whole run, and that nothing jumps."""
    speed, accel = played.speeds(0, max(ns for ns, _, _ in played.sent))
    for column, joint in enumerate(robot.joints.values()):
        # A fitted course of a filter oscillates within its tolerance, with every step.
        slack, room = (1.06, 0.2 / 0.02**2) if joint.drive == "streamed" else (1.01, 0.0)
        assert np.abs(speed[:, column]).max() <= slack * joint.speed_max_deg_s
        assert np.abs(accel[:, column]).max() <= 1.02 * joint.accel_max_deg_s2 + room


def phases(played):
    return [event.phase for event in played.events if isinstance(event, PhaseEntered)]


@pytest.fixture
def robot(kit):
    return kit.robot(2, baud_bps=115200)


@pytest.fixture
def show(kit):
    return kit.sequence(2, 12.0, step_s=(0.6, 0.9))


@pytest.mark.parametrize("drive", ["timed", "streamed"])
def test_a_leader_that_comes_running_is_met_at_the_first_instant(stage, kit, drive):
    robot = kit.robot(2, baud_bps=115200, drive=drive)
    show = kit.sequence(2, 4.0, step_s=(0.6, 0.9))
    leader = Leader(lambda s: (s - 5.0, 1.0))
    played = leader.play(stage, robot, show)
    alone = stage.play(robot, show)
    assert played.report.outcome == "finished"
    assert leader.texts == ["waits for its leader", "in step with its leader"]
    assert np.abs(leader.off_s(5.0)).max() < 1e-6
    assert [name for _, name in leader.notes].count("run_from") == 1
    assert played.moves() == alone.moves(), "to the byte as a show that follows nothing"


def test_a_leg_ahead_starts_the_show_at_exactly_that_instant(stage, kit, robot):
    show = kit.sequence(2, 4.0, step_s=(0.6, 0.9))
    started = []

    def at(seconds):
        if seconds > 0.0 and not started:
            started.append(leader.next_ns + 4 * S)
            leader.following.lead(LeaderPosition(started[0], 0.0, 1.0), leader.next_ns)

    leader = Leader(at, FollowRule(freewheel_s=None))
    seen = []
    leader.acts = [(6.0, lambda _, player, now_ns: seen.append((now_ns, player.show)))]
    played = leader.play(stage, robot, show)
    ((now_ns, clock),) = [(ns, show.clock) for ns, show in seen]
    assert played.report.outcome == "finished"
    assert clock.show_s(now_ns) == pytest.approx((now_ns - started[0]) / S, abs=1e-9)


@pytest.mark.parametrize("rate", [1.0001, 1.005, 0.995])
def test_another_speed_is_trimmed_and_no_limit_is_broken(stage, robot, show, rate):
    leader = Leader(lambda s: (rate * (s - 3.0), rate))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert np.abs(leader.off_s(4.0)).max() < 1e-3
    assert leader.following.jumps == 0
    assert_limits_hold(played, robot)
    assert played.report.timing.missed == 0


@pytest.mark.parametrize(("drive", "by_s"), [("timed", 2.0), ("streamed", -4.0), ("timed", 0.15)])
def test_a_jump_brakes_approaches_and_arrives_in_step(stage, kit, drive, by_s):
    robot = kit.robot(2, baud_bps=115200, drive=drive)
    show = kit.sequence(2, 12.0, step_s=(0.6, 0.9))
    leader = Leader(lambda s: (s - 3.0 + (by_s if s > 7.0 else 0.0), 1.0))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert "seeking" in phases(played)
    assert leader.following.jumps == 1
    assert_limits_hold(played, robot)
    both = zip(leader.course, leader.steps, strict=True)
    joined = [s for (s, _, _), step in both if step is FollowingStep.RUNNING]
    gap = max(np.diff(joined))
    assert gap < 6.0
    back_s = next(s for s in joined if s > 7.2)
    assert np.abs(leader.off_s(back_s + 1.0)).max() < 2e-3


@pytest.mark.parametrize("drive", ["timed", "streamed"])
def test_a_leader_that_says_before_that_it_slows_down_is_followed_without_a_stop(stage, kit, drive):
    robot = kit.robot(2, baud_bps=115200, drive=drive)
    show = kit.sequence(2, 12.0, step_s=(0.6, 0.9))
    turns = {6.0: LeaderPosition(0, 3.0, 0.5), 10.0: LeaderPosition(0, 5.0, 1.0)}

    def at(s):
        return 0.5 * (s - 6.0) + 3.0 if 6.0 <= s < 10.0 else s - (3.0 if s < 6.0 else 5.0)

    def told(s):
        for turn_s, leg in turns.items():
            if turn_s - 0.6 <= s < turn_s:
                ahead = leg._replace(instant_ns=leader.start_ns + int(turn_s * S))
                leader.following.lead(ahead, leader.next_ns)
                return None
        return at(s), 0.5 if 6.0 <= s < 10.0 else 1.0

    leader = Leader(told, FollowRule(slowest=SLOW_RATE))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert leader.following.jumps == 0
    assert "seeking" not in phases(played)
    off_s = [abs(led_s - show_s) for s, show_s, led_s in leader.course if 7.0 < s < 9.3 or s > 11.5]
    assert len(off_s) > 50
    assert max(off_s) < 5e-3
    assert_limits_hold(played, robot)


def test_a_leader_that_stands_or_is_reversed_holds_the_robot_and_goes_on_with_it(
    stage, robot, show
):
    def at(s):
        if s < 7.0:
            return s - 3.0, 1.0
        if s < 10.0:
            return 4.0, 0.0
        return s - 6.0, 1.0

    leader = Leader(at)
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    stood = {round(show_s, 6) for s, show_s, _ in leader.course if 8.5 < s < 9.9}
    assert len(stood) == 1, "it holds"
    assert np.abs(leader.off_s(14.0)).max() < 2e-3
    assert_limits_hold(played, robot)


def test_a_leader_that_seeks_is_gone_to_and_waited_for_and_the_show_begins_with_it(
    stage, robot, show
):
    """As the figure of a conductor that goes to 1.5 s and starts there at 10 s."""

    def told(s):
        if s < 7.0:
            return s - 3.0, 1.0
        if s < 9.4:
            return 1.5, 0.0
        if s > 10.0:
            return s - 8.5, 1.0
        ahead = LeaderPosition(leader.start_ns + 10 * S, 1.5, 1.0)
        leader.following.lead(ahead, leader.next_ns)
        return None

    leader = Leader(told, FollowRule(slowest=SLOW_RATE, goes_to_it=True))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    stood = [show_s for s, show_s, _ in leader.course if 9.0 < s < 9.4]
    assert stood == [1.5] * len(stood)
    assert len(stood) > 5
    course = [(s, show_s) for s, show_s, _ in leader.course if s > 10.3]
    assert len(course) > 50
    assert max(abs(show_s - (s - 8.5)) for s, show_s in course) < 2e-3
    assert leader.following.jumps == 0
    assert_limits_hold(played, robot)


@pytest.mark.parametrize("place_s", [-5.0, 1e6])
def test_a_leader_that_stands_beyond_the_show_is_not_gone_to(stage, robot, show, place_s):
    leader = Leader(
        lambda s: (place_s, 0.0) if 7.0 < s < 9.0 else (s - 3.0, 1.0),
        FollowRule(slowest=SLOW_RATE, goes_to_it=True),
    )
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert np.abs(leader.off_s(13.0)).max() < 2e-3


def test_that_a_leader_runs_beyond_the_end_is_said_once(stage, robot, show):
    leader = Leader(lambda s: (s - (-90.0 if 6.0 < s < 9.0 else 3.0), 1.0))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert sum("beyond the end" in text for text in leader.texts) == 1, leader.texts


@pytest.mark.parametrize("lost", ["go_on", "hold"])
def test_a_drop_out_is_bridged_and_a_loss_is_said(stage, robot, show, lost):
    leader = Leader(
        lambda s: None if 4.0 < s < 5.5 or 6.0 < s < 9.0 else (1.001 * (s - 3.0), 1.001),
        FollowRule(freewheel_s=2.0, lost=lost),
    )
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert np.abs(leader.off_s(5.5, 6.0)).max() < 1e-3, "after 1.5 s without it"
    does = "the show goes on" if lost == "go_on" else "the robot holds"
    assert [text for text in leader.texts if "no leader" in text] == [f"no leader for 2 s: {does}"]
    assert leader.following.jumps == 0
    assert ("seeking" in phases(played)) is (lost == "hold")
    assert np.abs(leader.off_s(13.5)).max() < 2e-3
    assert_limits_hold(played, robot)


@pytest.mark.parametrize("lost", ["go_on", "hold"])
def test_a_leader_that_stands_and_is_silent_then_is_lost(stage, robot, show, lost):
    """As a desk that is paused and then switched off; with `hold` it comes back."""

    def at(s):
        if s < 7.0 or s > 30.0:
            return (s - 3.0, 1.0) if s < 7.0 else (s - 26.0, 1.0)
        return (4.0, 0.0) if s < 8.0 else None

    leader = Leader(at, FollowRule(freewheel_s=2.0, lost=lost))
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert any("no leader for 2 s" in text for text in leader.texts)
    assert ("the leader is back" in leader.texts) is (lost == "hold")
    assert ("seeking" in phases(played)) is (lost == "hold")
    assert_limits_hold(played, robot)


def test_a_leader_that_stood_before_the_show_and_is_silent_does_not_begin_it(stage, robot, show):
    leader = Leader(lambda s: (-2.0, 0.0) if s < 2.0 else (s - 12.0, 1.0) if s > 10.0 else None)
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert np.abs(leader.off_s(12.0)).max() < 1e-3


@pytest.mark.parametrize("lost", ["go_on", "hold"])
@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_a_leader_beyond_the_end_that_is_gone_ends_the_show(stage, robot, show, lost, rate):
    class SourceStub:
        """Legs ten times a second for five seconds."""

        def filenos(self):
            return ()

        def take(self):
            return legs

        def take_texts(self):
            return ()

    legs, texts, start_ns = [], [], []
    controls = FollowControls(
        Following(FollowRule(freewheel_s=2.0, lost=lost)), SourceStub(), tell=texts.append
    )

    def turn(player, now_ns):
        start_ns.append(now_ns)
        seconds = (now_ns - start_ns[0]) / S
        legs[:] = [Follow(id=1, instant_ns=now_ns, show_s=20.0 + rate * seconds, rate=rate)]
        if seconds > 5.0:
            legs.clear()
        controls.act(player, now_ns)
        return False

    played = stage.play(robot, show, wishes=[(turn, None)])
    assert played.report.outcome == "stopped"
    assert texts[-1] == "no leader for 2 s: it was beyond the end of the show, which ends"


def test_a_person_may_pause_and_the_show_rejoins(stage, robot, show):
    leader = Leader(lambda s: (s - 3.0, 1.0))
    leader.acts = [
        (5.0, lambda own, *_: own.following.set_paused(is_paused=True)),
        (7.0, lambda own, *_: own.following.set_paused(is_paused=False)),
    ]
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert np.abs(leader.off_s(11.0)).max() < 2e-3
    assert_limits_hold(played, robot)


def test_garbage_legs_break_no_limit_and_end_in_step(stage, robot, show):
    luck = np.random.default_rng(5)

    def at(s):
        if 4.0 < s < 8.0:
            return float(luck.uniform(-50.0, 50.0)), float(luck.choice([0.0, 1.0, 1.9]))
        return s - 3.0 - (6.0 if s > 8.0 else 0.0), 1.0

    leader = Leader(at)
    played = leader.play(stage, robot, show)
    assert played.report.outcome == "finished"
    assert_limits_hold(played, robot)
    assert np.abs(leader.off_s(15.0)).max() < 2e-3


@pytest.mark.parametrize("seed", range(8))
def test_after_any_legs_silence_lets_a_show_that_has_begun_come_to_its_end(
    stage, robot, show, seed
):
    luck = np.random.default_rng(seed)
    turns = [(float(luck.uniform(-3.0, 14.0)), float(luck.choice([0.0, 1.0]))) for _ in range(4)]

    def at(s):
        if s < 5.0:
            return s - 3.0, 1.0
        if s >= 11.0:
            return None
        place_s, rate = turns[int((s - 5.0) / 1.5)]
        return place_s + rate * ((s - 5.0) % 1.5), rate

    def end(own, player, now_ns):
        """Stop it as `FollowControls` does, or fail a show that would hold for ever."""
        if own.following.is_over:
            player.stop(now_ns)

    leader = Leader(at)
    leader.acts = [(float(s), end) for s in range(12, 60)]
    played = leader.play(stage, robot, show)
    assert played.report.outcome == ("stopped" if leader.following.is_over else "finished")
    assert_limits_hold(played, robot)


def test_a_plan_with_headroom_keeps_the_limits_when_it_is_trimmed(kit, robot):
    show = kit.sequence(2, 6.0, step_s=(0.25, 0.4))  # Too fast: it is slowed to the limits.
    times_s = np.arange(0.0, 6.0, 0.001)
    joint = robot.joints["j0"]

    def excess(is_following):
        """Speed and acceleration of the plan at 1.005 of its rate, relative to the limits."""
        trajectory = shows.compiled(show, robot, is_following=is_following).trajectory
        angles = trajectory.sample(times_s)
        speed = 1.005 * np.abs(np.diff(angles, axis=0)).max() / 0.001
        accel = 1.005**2 * np.abs(np.diff(angles, n=2, axis=0)).max() / 0.001**2
        return max(speed / joint.speed_max_deg_s, accel / joint.accel_max_deg_s2)

    assert excess(is_following=True) < 1.001
    assert excess(is_following=False) > 1.004
