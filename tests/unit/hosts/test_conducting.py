"""The director of a stage with figures: cues from any figure, one show at a time on all of them."""

import re
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from benches.network import moving, one_joint, played
from benches.stage_model import World
from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.schema import Follow
from lss_motion.playing.remote.stage_messages import StageState
from lss_motion.stage.hosts.conducting import ConductedStage, Offer
from lss_motion.stage.hosts.conductor import ARM_LEAD_LEAST_S, ARM_LEAD_RATIO, ARM_LEAD_S
from lss_motion.stage.hosts.messages import Ask, Cast, Catalogue, Part, hash_of, packed
from lss_motion.stage.load import load_stage
from lss_motion.stage.stage_timecode import StageTimecode
from lss_motion.units import NS_PER_S

ROBOT = """\
robot: arm
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
defaults: {model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {j: {id: 1, range_deg: [-90, 90]}}
"""
STAGE = """\
stage: hall
figures: {f0: {robot: robot.yaml}, f1: {robot: robot.yaml}, f2: {robot: robot.yaml}}
conductor: f0
shows: {idle: idle.yaml, hello: hello.yaml, scare: scare.yaml}
idle: idle
cues:
  - {cue: door, on: {osc: /door}, play: scare, start: interrupt}
  - {cue: hi, on: {key: h}, play: hello, start: queue}
listen: {osc: "127.0.0.1:9000"}
on_fault: {others: hold, wait_s: 3}
"""
LONG_S = 20.0


class Bridge:
    """The host of the conductor without its network and its player, in virtual time."""

    def __init__(self, world):
        self.world, self.conducts = world, world.conductor

    def keep(self, contents):
        self.world.store.update({hash_of(one): one for one in contents})

    def offer(self, casts):
        catalogue = packed(Catalogue(casts=tuple(hash_of(packed(cast)) for cast in casts)))
        self.keep([catalogue])
        self.conducts.catalogue = hash_of(catalogue)


def begun(folder, text, timecode=None, show_s=LONG_S):
    """A stage in virtual time, from its file; `timecode` gives the legs of its timecode."""
    (folder / "robot.yaml").write_text(ROBOT)
    for name in ("idle", "hello", "scare"):
        (folder / f"{name}.yaml").write_text("sequence: x\n")
    (folder / "hall.yaml").write_text(text)
    stage = load_stage(folder / "hall.yaml")
    world = World(3, seed=2, show_s=show_s)
    bridge, records = Bridge(world), []
    offers = {}
    for name in stage.shows:
        plans = {figure: f"{figure} plays {name}".encode() for figure in world.cast.parts}
        parts = {
            figure: Part(plan=hash_of(plans[figure]), robot=part.robot)
            for figure, part in world.cast.parts.items()
        }
        cast = Cast(show=name, duration_s=show_s, parts=parts)
        contents = {hash_of(one): one for one in (packed(cast), *plans.values())}
        offers[name] = Offer(cast, contents)
    given = stage.sync.timecode
    led = None if given is None else StageTimecode(given, timecode(world))
    run = ConductedStage(stage, offers, bridge, records.append, seed=1, timecode=led)
    texts = lambda: " | ".join(one["text"] for one in records)  # noqa: E731

    def until(is_true, seconds):
        def turn():
            run.turn(world.now_ns)
            return is_true()

        assert world.run(seconds, turn), (texts()[-600:], world.states())

    def playing(show):
        main = run.director.main
        is_under_way = run.conductor.state == "playing" and world.states() == {"playing"}
        return is_under_way and main is not None and main.show == show

    return SimpleNamespace(
        world=world, run=run, until=until, playing=playing, texts=texts, conductor=world.conductor
    )


def test_a_cue_at_a_time_of_day_says_when_it_comes_before_anything_has_happened(tmp_path):
    strikes = '  - {cue: strikes, on: {time: "0 * * * *"}, play: hello, start: queue}\nlisten:'
    run = begun(tmp_path, STAGE.replace("listen:", strikes)).run
    assert re.fullmatch(r"next \d\d:00", run.state_of()["cues"][-1]["when"])


@pytest.fixture
def evening(tmp_path):
    return begun(tmp_path, STAGE)


def ask(operation):
    return Ask(operation=operation, number=1, instance="0" * 16)


def key(address):
    return ask(s.Trigger(kind="key", address=address, source="keyboard"))


DOOR = ask(s.Trigger(kind="osc", address="/door", value=1.0))


def test_a_trigger_at_any_figure_interrupts_the_show_of_all_which_is_resumed(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.until(lambda: evening.conductor.show_s(evening.world.now_ns) > 2.0, 10.0)
    evening.run.take("f2", key("h"))
    evening.until(lambda: evening.playing("hello"), 60.0)
    evening.until(lambda: evening.conductor.show_s(evening.world.now_ns) > 5.0, 10.0)
    evening.run.take("f1", DOOR)
    evening.until(lambda: evening.playing("scare"), 30.0)
    assert evening.conductor.legs.newest.show_s == 0.0
    evening.until(lambda: evening.playing("hello"), 60.0)
    assert 5.0 <= evening.conductor.legs.newest.show_s < 8.0  # Where it was left.
    starts = [one.player.follows[-1][1] for one in evening.world.hosts.values()]
    assert len(starts) == 3
    state = msgspec.convert({**evening.run.state_of(), "show_plan": None}, StageState)
    assert [one.name for one in state.hosts] == ["f0", "f1", "f2"]
    assert all(one.is_good and one.bound_ms < 5.0 for one in state.hosts)
    assert (state.state, state.show) == ("plays", "hello")


def test_what_may_come_is_fetched_and_verified_before_so_that_a_cue_waits_for_robots_only(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.until(lambda: evening.conductor.show_s(evening.world.now_ns) > 3.0, 10.0)
    logs = [one.log for one in evening.world.hosts.values()]
    marks = [len(log) for log in logs]
    evening.run.take("f1", DOOR)
    evening.until(lambda: evening.playing("scare"), 30.0)
    for log, mark in zip(logs, marks, strict=True):
        assert not any("fetching" in line or "verifying" in line for line in log[mark:]), log[mark:]


def test_a_figure_that_is_lost_for_long_ends_the_show_and_the_stage_begins_again(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    host = evening.world.hosts["f1"]
    host.is_cut = True
    evening.until(lambda: "waits after a fault" in evening.texts(), 80.0)
    assert "f1: lost" in evening.texts()
    host.is_cut = False
    host.start()
    evening.until(lambda: evening.playing("idle"), 60.0)


def test_a_stage_that_goes_on_without_a_figure_begins_without_one(tmp_path):
    own = begun(tmp_path, STAGE.replace("others: hold", "others: go_on"))
    world = own.world
    own.conductor.others = "go_on"
    world.hosts["f1"].is_cut = True
    states = {}

    def plays_without():
        states.update({name: host.figure.state for name, host in world.hosts.items()})
        return states["f0"] == states["f2"] == "playing"

    own.until(plays_without, 100.0)
    assert 60.0 < world.now_ns / NS_PER_S < 90.0
    assert "begins without f1" in own.texts()
    assert "starts without f1: it has not connected" in " ".join(world.notes)
    world.hosts["f1"].is_cut = False
    own.until(lambda: own.playing("idle"), 30.0)


def test_a_stage_that_holds_for_a_figure_waits_for_it(evening):
    evening.world.hosts["f1"].is_cut = True
    evening.world.run(80.0, lambda: evening.run.turn(evening.world.now_ns))
    assert evening.texts() == ""


def test_a_cue_that_there_is_not_is_named_and_a_stop_ends_all(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.run.take("f1", ask(s.FireCue(label="nothing")))
    assert "f1: no cue 'nothing'; there are" in evening.texts()
    evening.run.director.do("rest", evening.world.now_ns)
    evening.until(lambda: evening.world.states() == {"stopped"}, 20.0)
    began_ns = evening.world.now_ns
    evening.run.director.do("wake", began_ns)
    evening.until(lambda: evening.playing("idle"), 30.0)
    assert evening.world.now_ns - began_ns < 15 * NS_PER_S


def test_a_stop_at_any_figure_lasts_until_something_is_played(evening):
    world, conductor = evening.world, evening.conductor
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.run.take("f2", key("h"))
    conductor.stop(world.now_ns)
    evening.run.take("f2", ask(m.Stop()))
    evening.until(lambda: world.states() == {"stopped"}, 10.0)
    run_until_ns = world.now_ns + 20 * NS_PER_S
    evening.until(lambda: world.now_ns >= run_until_ns, 30.0)
    assert world.states() == {"stopped"}
    evening.run.take("f1", ask(m.Go()))
    evening.until(lambda: evening.playing("idle"), 30.0)
    assert "GO: the stage goes on" in evening.texts()


def test_what_figures_cannot_do_together_is_refused_with_its_line(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "idle.yaml").write_text("sequence: x\n")
    text = STAGE.replace(
        "hello: hello.yaml, scare: scare.yaml", "hello: idle.yaml, scare: idle.yaml"
    )
    text = text.replace("start: queue", "start: add") + "duty: {rest: idle, limp: true}\n"
    text += "sync:\n  send: [{kind: artnet, output: 127.0.0.1}]\n"
    (tmp_path / "hall.yaml").write_text(text)
    with pytest.raises(InputError) as refused:
        load_stage(tmp_path / "hall.yaml")
    found = {(one.line, one.reason) for one in (refused.value, *refused.value.more)}
    assert any(line == 8 and "figures play one show together" in reason for line, reason in found)
    assert any(line == 11 and "limp belongs to one robot" in reason for line, reason in found)
    assert any(
        line == 13 and "does not send its clock: take send" in reason for line, reason in found
    )


# ---- timecode

LED = STAGE.replace(
    "cues:\n",
    'cues:\n  - {cue: song, on: {timecode: "00:00:40:00"}, play: hello, start: terminate}\n',
).replace("idle: idle\n", "", 1) + (
    "sync: {timecode: {source: fpp, rate_fps: 25, freewheel_s: 2, lost: hold}}\n"
)
BEGIN_S = 40.0
RATE = 1.0003
"""Of the desk, whose clock is 300 ppm faster than that of the conductor."""


class ConductingDesk:
    """Gives ten legs a second: `at(seconds)` is a position and a rate, or None."""

    def __init__(self, world, at):
        self.world, self.at, self.next_ns = world, at, 0

    def filenos(self):
        return ()

    def take_texts(self):
        return ()

    def take(self):
        found = []
        while self.next_ns <= self.world.now_ns:
            led = self.at(self.next_ns / NS_PER_S)
            if led is not None:
                show_s, rate = led
                found.append(
                    Follow(id=1, instant_ns=self.next_ns, show_s=show_s, rate=rate, source="desk")
                )
            self.next_ns += NS_PER_S // 10
        return found


def late_ms(host, at):
    """How late the moves reached the servo of a host, by the timecode, and at which true second."""
    robot = one_joint()
    program = moving(robot, LONG_S)
    due_s = np.array([move.due_us / 1e6 for move in program.moves])
    found = []
    for own_ns in played(program, robot, host.player.follows):
        true_s = host.clock.true_ns(own_ns) / NS_PER_S
        led_s = at(true_s)[0] - BEGIN_S
        found.append((true_s, 1000.0 * min(led_s - due_s, key=abs)))
    return np.array(found)


def test_timecode_leads_all_figures_from_their_first_move_through_a_stand_and_a_jump(tmp_path):
    def at(seconds):
        """From 20 s; stands at 46 s for 4 s of the conductor; jumps back at 52 s."""
        position_s = 20.0 + RATE * seconds
        if position_s < 46.0:
            return position_s, RATE
        position_s -= 4.0 * RATE
        if position_s < 46.0:
            return 46.0, 0.0
        return position_s - (5.0 if position_s >= 52.0 else 0.0), RATE

    own = begun(tmp_path, LED, lambda world: ConductingDesk(world, at))
    own.until(lambda: own.playing("hello"), 30.0)
    hosts = own.world.hosts.values()
    own.until(lambda: all(host.player.does == "ended" for host in hosts), 60.0)
    for host in hosts:
        late = late_ms(host, at)
        true_s, off_ms = late[:, 0], late[:, 1]
        before = off_ms[true_s < 25.9]
        assert len(before) >= 5
        assert np.abs(before).max() < 3.0, "from the first move on"
        assert np.abs(off_ms[(true_s > 33.0) & (true_s < 35.9)]).max() < 5.0
        after = off_ms[true_s > 43.0]
        assert len(after) >= 2
        assert np.abs(after).max() < 5.0


def test_a_pause_and_a_lost_figure_hold_all_whatever_the_timecode_does(tmp_path):
    def at(seconds):
        return (20.0 + RATE * seconds, RATE) if seconds < 40.0 else None

    own = begun(tmp_path, LED, lambda world: ConductingDesk(world, at), show_s=40.0)
    world, conductor = own.world, own.conductor

    def run(seconds):
        end_ns = world.now_ns + seconds * NS_PER_S
        own.until(lambda: world.now_ns >= end_ns, seconds + 1.0)

    def off_s():
        led_s = at(world.now_ns / NS_PER_S)[0] - BEGIN_S
        return [host.player.report.show_s - led_s for host in world.hosts.values()]

    own.until(lambda: own.playing("hello") and conductor.show_s(world.now_ns) > 2.0, 40.0)
    conductor.pause(world.now_ns)
    run(3.0)
    assert conductor.legs.newest.rate == 0.0, "a person has paused it"
    conductor.pause(world.now_ns, is_paused=False)
    run(4.0)
    assert off_s() == pytest.approx([0.0] * 3, abs=0.03)
    world.hosts["f2"].is_cut = True
    run(4.0)
    assert conductor.legs.newest.rate == 0.0, "others: hold"
    world.hosts["f2"].is_cut = False
    run(4.5)
    assert off_s() == pytest.approx([0.0] * 3, abs=0.03)
    run(5.0)
    assert at(world.now_ns / NS_PER_S) is None
    assert conductor.legs.newest.rate == 0.0, "lost: hold"


def test_a_show_joins_the_timecode_after_as_long_as_the_robots_needed_before(tmp_path):
    def at(seconds):
        """In the middle of the show, then 6 s outside of it, and in it again."""
        return (45.0 if seconds < 20.0 else 95.0 if seconds < 26.0 else 20.0) + seconds, 1.0

    own = begun(tmp_path, LED, lambda world: ConductingDesk(world, at), show_s=40.0)
    world, conductor = own.world, own.conductor
    leads_s = []
    for _ in range(2):
        own.until(lambda: conductor.wanted == "armed", 30.0)
        led_s = at(world.now_ns / NS_PER_S)[0] - BEGIN_S
        leads_s.append(conductor.beat().start_s - led_s)
        own.until(lambda: own.playing("hello"), 19.0)
        own.until(lambda: conductor.wanted != "armed", 30.0)
    needed_s = conductor.armed_s
    assert 1.0 < needed_s < 5.0
    wanted_s = [ARM_LEAD_S, max(ARM_LEAD_LEAST_S, ARM_LEAD_RATIO * needed_s + 1.0)]
    assert leads_s == pytest.approx(wanted_s, abs=0.1)
