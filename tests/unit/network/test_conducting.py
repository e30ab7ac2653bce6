"""The director of a stage with figures: cues from any figure, one show at a time on all of them."""

from types import SimpleNamespace

import pytest

from benches.stage_model import World
from lss_motion.errors import InputError
from lss_motion.network.conducting import Conducting, Offer
from lss_motion.network.messages import Ask, Cast, hash_of, packed
from lss_motion.remote.stage_messages import StageState
from lss_motion.stage.load import load_stage
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
    """What `Host` does for `Conducting`, in virtual time."""

    def __init__(self, world):
        self.world, self.conductor = world, world.conductor
        self.is_arming, self.leader = False, None

    def load(self, cast, contents):
        self.world.store |= contents
        self.conductor.load(cast)

    def problems(self):
        return self.conductor.problems(self.world.now_ns)

    def go(self, start_s, leader):
        self.conductor.arm(self.world.now_ns, start_s)
        self.is_arming, self.leader = True, leader

    def stop(self):
        self.conductor.stop()

    def tick(self):
        conductor, now_ns = self.conductor, self.world.now_ns
        if self.is_arming and conductor.is_armed(now_ns):
            self.is_arming = False
            conductor.start(now_ns)
        show_s = conductor.show_s(now_ns)
        if show_s is not None and show_s > conductor.cast.duration_s + 1.0:
            conductor.end()


@pytest.fixture
def evening(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    for name in ("idle", "hello", "scare"):
        (tmp_path / f"{name}.yaml").write_text("sequence: x\n")
    (tmp_path / "hall.yaml").write_text(STAGE)
    stage = load_stage(tmp_path / "hall.yaml")
    world = World(3, seed=2, show_s=LONG_S)
    bridge, records = Bridge(world), []
    offers = {}
    for name in stage.shows:
        cast = Cast(show=name, duration_s=LONG_S, parts=world.cast.parts)
        offers[name] = Offer(cast, {hash_of(packed(cast)): packed(cast)})
    run = Conducting(stage, offers, bridge, records.append, seed=1)
    texts = lambda: " | ".join(one["text"] for one in records)  # noqa: E731

    def until(is_true, seconds):
        def turn():
            bridge.tick()
            run.turn(world.now_ns)
            return is_true()

        assert world.run(seconds, turn), (texts()[-600:], world.states())

    def playing(show):
        main = run.director.main
        is_under_way = run.phase == "playing" and world.states() == {"playing"}
        return is_under_way and main is not None and main.show == show

    return SimpleNamespace(
        world=world, run=run, until=until, playing=playing, texts=texts, conductor=world.conductor
    )


def ask(**fields):
    return Ask(number=1, instance="0" * 16, **fields)


def test_a_trigger_at_any_figure_interrupts_the_show_of_all_which_is_resumed(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.until(lambda: evening.conductor.show_s(evening.world.now_ns) > 2.0, 10.0)
    evening.run.take("f2", ask(what="trigger", kind="key", cue="h", source="keyboard"))
    evening.until(lambda: evening.playing("hello"), 60.0)
    evening.until(lambda: evening.conductor.show_s(evening.world.now_ns) > 5.0, 10.0)
    evening.run.take("f1", ask(what="trigger", kind="osc", cue="/door", value=1.0))
    evening.until(lambda: evening.playing("scare"), 30.0)
    assert evening.conductor.leg.show_s == 0.0
    evening.until(lambda: evening.playing("hello"), 60.0)
    assert 5.0 <= evening.conductor.leg.show_s < 8.0  # Where it was left.
    starts = [one.player.follows[-1][1] for one in evening.world.hosts.values()]
    assert len(starts) == 3
    state = StageState(**evening.run.state_of(), show_plan=None)
    assert [one.name for one in state.hosts] == ["f0", "f1", "f2"]
    assert all(one.is_good and one.bound_ms < 5.0 for one in state.hosts)
    assert (state.state, state.show) == ("plays", "hello")


def test_a_figure_that_is_lost_for_long_ends_the_show_and_the_stage_begins_again(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    host = evening.world.hosts["f1"]
    host.is_cut = True
    evening.until(lambda: "waits after a fault" in evening.texts(), 80.0)
    assert "f1: lost" in evening.texts()
    host.is_cut = False
    host.start()
    evening.until(lambda: evening.playing("idle"), 60.0)


def test_a_cue_that_there_is_not_is_named_and_a_stop_ends_all(evening):
    evening.until(lambda: evening.playing("idle"), 30.0)
    evening.run.take("f1", ask(what="cue", cue="nothing"))
    assert "f1 fires cue 'nothing', which there is not" in evening.texts()
    evening.run.director.do("rest", evening.world.now_ns)
    evening.until(lambda: evening.world.states() == {"stopped"}, 20.0)
    began_ns = evening.world.now_ns
    evening.run.director.do("wake", began_ns)
    evening.until(lambda: evening.playing("idle"), 30.0)
    assert evening.world.now_ns - began_ns < 15 * NS_PER_S


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
