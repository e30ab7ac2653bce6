"""Conductor and figures together, in virtual time over modelled links and clocks."""

import statistics

import pytest
from msgspec.structs import asdict, replace

from benches.stage_model import LOOPBACK, WIFI, World, reported
from lss_motion.errors import InputError
from lss_motion.stage.hosts.conductor import READY_S, ConductorState
from lss_motion.stage.hosts.figure import Fetch, FollowingFigure, Verify
from lss_motion.stage.hosts.legs import LEAD_NS
from lss_motion.stage.hosts.messages import ConductorBeat, hash_of
from lss_motion.units import NS_PER_MS, NS_PER_S


def playing(**options):
    world = World(4, **{"seed": 1, **options})
    world.go()
    assert world.run(5.0, lambda: world.states() == {"playing"}), world.states()
    return world


@pytest.mark.parametrize(("link", "goal_ms"), [(LOOPBACK, 2.0), (WIFI, 5.0)], ids=["wired", "wifi"])
def test_all_are_at_the_same_place_of_the_show(link, goal_ms):
    world = playing(link=link, show_s=40.0, ppm=100.0)
    world.run(12.0)
    for show_s in (0.0, 5.0, 10.0):
        at_ns = world.spread_ns(show_s)
        assert len(at_ns) == 4
        assert max(at_ns) - min(at_ns) <= goal_ms * NS_PER_MS


def test_a_leg_takes_effect_a_second_ahead_for_all():
    world = playing()
    conductor, before_ns = world.conductor, world.now_ns
    conductor.pause(before_ns)
    assert conductor.legs.newest.instant_ns >= before_ns + LEAD_NS
    place_s = conductor.legs.newest.show_s
    world.run(2.0)
    shown = [host.player.report.show_s for host in world.hosts.values()]
    assert shown == pytest.approx([place_s] * 4, abs=1e-9)
    conductor.pause(world.now_ns, is_paused=False)
    world.run(2.0)
    shown = [host.player.report.show_s for host in world.hosts.values()]
    assert statistics.mean(shown) == pytest.approx(conductor.show_s(world.now_ns), abs=0.02)
    assert max(shown) - min(shown) <= 0.02  # They are seen at the ticks of the model.


def test_another_speed_is_one_that_figures_follow_and_lasts_until_the_next_start():
    world = playing(show_s=60.0)
    conductor = world.conductor
    for asked, rate in ((0.5, 0.5), (0.07, 0.2), (0.9, 0.85), (0.93, 1.0), (0.33, 0.35)):
        assert conductor.set_rate(asked, world.now_ns) == rate
        world.run(2.5)
        shown = [host.player.report.show_s for host in world.hosts.values()]
        assert conductor.legs.newest.rate == rate
        assert shown == pytest.approx([conductor.show_s(world.now_ns)] * 4, abs=0.02)
    conductor.pause(world.now_ns)
    assert conductor.legs.newest.rate == 0.0
    world.run(2.0)
    conductor.pause(world.now_ns, is_paused=False)
    assert conductor.legs.newest.rate == 0.35
    conductor.leave(world.now_ns)
    world.go()
    assert conductor.legs.newest.rate == 1.0


def test_a_slow_show_is_slowed_further_for_a_lost_figure_as_far_as_figures_follow():
    world = playing(others="slow", show_s=120.0)
    world.conductor.set_rate(0.3, world.now_ns)
    world.hosts["f2"].is_cut = True
    world.run(4.0)
    assert world.conductor.legs.newest.rate == 0.2


def test_nothing_is_paused_or_sought_that_does_not_play():
    world = World(2, seed=3)
    conductor = world.conductor
    for call in (conductor.pause, lambda ns: conductor.set_rate(0.5, ns)):
        with pytest.raises(InputError, match="no show plays"):
            call(0)
    world = playing(show_s=30.0)
    with pytest.raises(InputError, match=r"30 s is not in the show, which ends at 30.0 s"):
        world.conductor.seek(30.0, world.now_ns)


@pytest.mark.parametrize("is_paused", [False, True])
def test_a_sought_place_is_played_from_when_all_robots_stand_there(is_paused):
    world = playing(show_s=60.0)
    conductor = world.conductor
    for name, host in world.hosts.items():
        host.player.way_ns = (3 if name == "f2" else 1) * NS_PER_S
    conductor.seek(40.0, world.now_ns)
    if is_paused:
        world.run(0.5)
        conductor.pause(world.now_ns)
    assert not world.run(3.5, lambda: conductor.legs.newest.rate > 0.0)
    assert {host.player.report.show_s for host in world.hosts.values()} == {40.0}
    if is_paused:
        assert not world.run(3.0, lambda: conductor.legs.newest.rate > 0.0)
        conductor.pause(world.now_ns, is_paused=False)
    assert world.run(1.5, lambda: conductor.legs.newest.rate == 1.0)
    assert conductor.legs.newest.show_s == 40.0
    assert conductor.legs.newest.instant_ns >= world.now_ns + LEAD_NS - NS_PER_S // 10
    world.run(3.0)
    shown = [host.player.report.show_s for host in world.hosts.values()]
    assert shown == pytest.approx([conductor.show_s(world.now_ns)] * 4, abs=0.02)
    for host in world.hosts.values():  # A robot that stands begins half of its ramp before.
        early_ns = [one.instant_ns - at for at, one in host.player.follows if one.show_s == 40.0
                    and one.rate > 0.5]  # fmt: skip
        assert max(early_ns) > 400 * NS_PER_MS


def test_a_figure_that_does_not_come_to_a_sought_place_is_not_waited_for_for_ever():
    world = playing(show_s=60.0)
    world.hosts["f2"].player.way_ns = 300 * NS_PER_S
    world.conductor.seek(40.0, world.now_ns)
    assert world.run(35.0, lambda: world.conductor.legs.newest.rate == 1.0)


def test_pause_and_resume_within_a_second_lose_nothing():
    world = playing()
    conductor = world.conductor
    conductor.pause(world.now_ns)
    world.run(0.2)
    conductor.pause(world.now_ns, is_paused=False)
    world.run(3.0)
    shown = [host.player.report.show_s for host in world.hosts.values()]
    assert shown == pytest.approx([conductor.show_s(world.now_ns)] * 4, abs=0.02)


def test_stop_is_once_however_often_it_arrives():
    world = playing()
    conductor = world.conductor
    conductor.stop(world.now_ns)
    conductor.stop(world.now_ns)
    stop = conductor.stop_message()
    for _ in range(20):
        for host in world.hosts.values():
            host.figure.take_stop(stop)
        world.run(0.1)
    assert world.states() == {"stopped"}
    assert [host.player.stops for host in world.hosts.values()] == [1] * 4


def test_what_was_said_before_changes_nothing_when_it_is_said_again(monkeypatch):
    """Somebody on a trusted network sends a recorded show again while the conductor is there."""
    heard, take_beat = [], FollowingFigure.take_beat

    def noted(figure, beat, now_ns):
        heard.append(beat)
        take_beat(figure, beat, now_ns)

    monkeypatch.setattr(FollowingFigure, "take_beat", noted)
    world = playing()
    conductor = world.conductor
    world.run(2.0)
    conductor.stop(world.now_ns)
    assert world.run(5.0, lambda: world.states() == {"stopped"})
    said = [beat for beat in dict.fromkeys(heard) if beat.wanted in ("ready", "armed")]
    assert any(beat.leg is not None for beat in said)
    starts = [host.player.starts for host in world.hosts.values()]
    for beat in said:
        for host in world.hosts.values():
            take_beat(host.figure, beat, host.now_ns())
        world.run(0.05)
        assert world.states() == {"stopped"}
    world.run(5.0)
    assert world.states() == {"stopped"}
    assert [host.player.starts for host in world.hosts.values()] == starts


def test_after_a_stop_the_same_show_can_be_played_again():
    world = playing()
    conductor = world.conductor
    conductor.stop(world.now_ns)
    assert world.run(5.0, lambda: world.states() == {"stopped"})
    stop = conductor.stop_message()
    world.play()
    world.wait(ConductorState.ARMING)
    world.hosts["f1"].figure.take_stop(stop)  # It comes late.
    world.wait(ConductorState.PLAYING)
    assert world.run(5.0, lambda: world.states() == {"playing"}), world.states()


def test_a_figure_that_the_show_left_behind_is_ready_for_the_next_one():
    world = playing(show_s=8.0, others="go_on")
    host = world.hosts["f2"]
    host.player.becomes("playing", 1.0)  # It holds somewhere, and never ends.
    host.player.tick = lambda _: host.player.report
    assert world.run(20.0, lambda: host.figure.state == "stopping"), host.log
    host.player.becomes("none")
    world.wait(ConductorState.STANDING)
    assert world.run(5.0, lambda: world.states() == {"ready"}), world.states()


def test_without_the_conductor_a_figure_freewheels_then_holds():
    world = playing(show_s=60.0)
    world.is_conducting = False
    world.run(1.5)
    assert world.states() == {"freewheeling"}
    before = [host.player.report.show_s for host in world.hosts.values()]
    world.run(0.5)
    after = [host.player.report.show_s for host in world.hosts.values()]
    assert [b - a for a, b in zip(before, after, strict=True)] == pytest.approx([0.5] * 4, abs=0.02)
    world.run(2.0)
    assert world.states() == {"holding"}
    assert all(host.player.report.stands for host in world.hosts.values())
    assert "the conductor is lost for 3." in " ".join(world.hosts["f1"].log)
    world.is_conducting = True
    assert world.run(5.0, lambda: world.states() == {"playing"})


@pytest.mark.parametrize(("others", "rate"), [("go_on", 1.0), ("slow", 0.5), ("hold", 0.0)])
def test_a_lost_figure_leaves_the_others_to_the_rule(others, rate):
    world = playing(others=others, show_s=120.0)
    lost, conductor = world.hosts["f2"], world.conductor
    lost.is_cut = True
    world.run(3.0)
    assert conductor.legs.newest.rate == rate
    assert "f2: lost" in " ".join(world.notes)
    assert world.hosts["f1"].figure.state == "playing"
    lost.is_cut = False
    assert world.run(
        20.0, lambda: conductor.legs.newest.rate == 1.0 and lost.figure.state == "playing"
    )


def test_a_host_that_starts_again_rejoins():
    world = playing(others="hold", show_s=120.0)
    conductor, host = world.conductor, world.hosts["f3"]
    world.run(5.0)
    host.start()
    assert world.run(3.0, lambda: conductor.legs.newest.rate == 0.0)
    assert world.run(30.0, lambda: world.states() == {"playing"}), host.log
    world.run(2.0)
    assert world.conductor.legs.newest.rate == 1.0
    shown = [one.player.report.show_s for one in world.hosts.values()]
    assert max(shown) - min(shown) <= 0.02
    assert "f3 has started again" in " ".join(world.notes)


@pytest.mark.slow
def test_a_figure_that_two_processes_serve_is_named_once_a_minute_and_cannot_start():
    world = World(3, seed=4)
    conductor, host = world.conductor, world.hosts["f1"]
    world.robots["f2"] = hash_of(b"another robot")
    world.hosts["f2"].start()  # So the show is not armed meanwhile.
    world.play()
    assert world.run(10.0, lambda: world.states() == {"ready", "out"})
    status = host.figure.status(host.now_ns())
    before = len(world.notes)
    for count in range(900):
        words = {"instance": "the other one", "text": "the port is in use"} if count % 2 else {}
        conductor.take_status(replace(status, **words), world.now_ns)
        world.run(0.1)
    notes = [note for note in world.notes[before:] if "f1" in note]
    assert sum("has started again" in note for note in notes) == 1, notes
    assert sum("the port is in use" in note for note in notes) == 1, notes
    assert sum("two processes serve it: end one of them" in note for note in notes) == 2, notes
    assert len(notes) == 4
    assert "f1: two processes serve it" in "; ".join(conductor.problems(world.now_ns))
    world.run(2.0)
    assert "f1" not in "; ".join(conductor.problems(world.now_ns))


def test_a_figure_whose_conductor_is_not_there_says_so_once():
    world = World(2, seed=1)
    world.is_conducting = False
    world.run(4.0)
    host = world.hosts["f1"]
    assert host.log == []
    world.run(20.0)
    assert len(host.log) == 1
    assert "nothing arrives from the conductor f0: is it served, are address" in host.log[0]
    world.is_conducting = True
    world.go()
    assert "nothing arrives" not in " ".join(host.log[1:])


def test_why_a_figure_stops_is_told_once():
    world = playing()
    host = world.hosts["f1"]
    host.player.tick = lambda _now_ns: reported("playing", 3.0)  # It takes long to stop.
    world.conductor.stop(world.now_ns)
    world.run(4.0)
    assert sum("stops: the conductor stopped all" in text for text in host.log) == 1, host.log


def test_why_a_figure_stops_is_told_again_after_a_show_that_left_it_behind():
    world = playing(show_s=8.0, others="go_on")
    host = world.hosts["f2"]
    tick = host.player.tick
    host.player.tick = lambda _: reported("playing", 1.0)  # It holds somewhere, and never ends.
    assert world.run(20.0, lambda: host.figure.state == "stopping"), host.log
    world.wait(ConductorState.STANDING)
    world.run(0.5)  # It is ready in the turn in which its player has ended.
    host.player.tick = tick
    host.player.becomes("none")
    assert world.run(5.0, lambda: world.states() == {"ready"}), world.states()
    world.go()
    world.run(3.0)
    mark = len(host.log)
    world.conductor.stop(world.now_ns)
    assert world.run(5.0, lambda: host.figure.state == "stopped")
    assert "stops: the conductor stopped all" in host.log[mark:], host.log[mark:]


def test_a_figure_that_fell_is_not_raised_again_in_the_same_run():
    world = playing(others="go_on", show_s=60.0)
    host = world.hosts["f1"]
    host.player.becomes("failed", text="joint 'jaw' is stuck")
    world.run(10.0)
    assert host.figure.state == "stopped"
    assert host.player.starts == 1
    assert "joint 'jaw' is stuck" in " ".join(world.notes)


def test_a_figure_that_holds_beyond_the_end_gives_up():
    world = playing(show_s=8.0)
    host = world.hosts["f1"]
    host.player.tick = lambda _now_ns: host.player.report  # It holds, and does not end.
    assert world.run(20.0, lambda: host.player.stops > 0)
    assert world.conductor.show_s(world.now_ns) > 8.0 + 2.0
    assert host.figure.text == "the show has ended without this figure"


def test_another_robot_stays_out_and_says_so():
    world = World(3, seed=2, robots={"f1": hash_of(b"another robot")})
    world.play()
    world.run(READY_S + 5.0)
    assert world.hosts["f1"].figure.state == "out"
    assert "f1: out: its robot file differs" in refusal(world)


def test_the_others_start_without_a_figure_if_they_go_on_without_one():
    world = World(3, seed=2, robots={"f1": hash_of(b"another robot")}, others="go_on", show_s=60.0)
    conductor = world.conductor
    world.play()
    world.wait(ConductorState.ARMING)
    assert list(conductor.absent(world.now_ns)) == ["f1"]
    world.wait(ConductorState.PLAYING, seconds=10.0)
    world.run(3.0)
    states = {name: host.figure.state for name, host in world.hosts.items()}
    assert states == {"f0": "playing", "f1": "out", "f2": "playing"}
    assert conductor.state is ConductorState.PLAYING
    assert "starts without f1: out: its robot file differs" in " ".join(world.notes)
    world.hosts["f1"].figure.robot = world.cast.parts["f1"].robot  # It got the right file.
    assert world.run(20.0, lambda: world.states() == {"playing"})


def test_a_show_does_not_start_without_all_of_its_figures():
    world = World(1, seed=2, robots={"f0": hash_of(b"another robot")}, others="go_on")
    world.play()
    world.run(READY_S + 5.0)
    assert "f0: out" in refusal(world)


def test_a_plan_that_is_stored_no_more_is_fetched_again():
    world = World(2, seed=1)
    host = world.hosts["f1"]
    plan, seen = world.cast.parts["f1"].plan, []

    def do(action, now_ns):
        if isinstance(action, Verify) and not seen:
            seen.append(action)
            host.figure.take_missing(plan)
        else:
            seen.extend([action] if isinstance(action, Fetch) and seen else [])
            type(host)._do(host, action, now_ns)

    host._do = do
    world.play()
    world.wait(ConductorState.ARMING, seconds=10.0)
    assert [type(one) for one in seen] == [Verify, Fetch]


def test_a_clock_that_is_not_known_refuses_the_start():
    slow = type(WIFI)(15 * NS_PER_MS, 0)
    world = World(2, seed=2, link=slow)
    world.play()
    world.run(READY_S + 5.0)
    assert "its clock is known to 15 ms only, allowed are 10" in refusal(world)


def refusal(world):
    (reason,) = [one[2] for one in world.told if one[0] == "refused"]
    return reason


def forged(world, **changes):
    beat = world.conductor.beat()
    return ConductorBeat(**{**asdict(beat), "count": beat.count + 1000, **changes})


@pytest.mark.parametrize(
    "changes",
    [{"count": 10**9}, {"count": 40}, {"count": 10**9, "leg": "later"}, {"examines": 10**9}],
    ids=["count", "near count", "leg", "examines"],
)
def test_one_forged_beat_does_not_deafen_a_figure(changes):
    world = playing(show_s=60.0)
    conductor, host = world.conductor, world.hosts["f1"]
    if changes.get("leg") == "later":
        changes = changes | {"leg": replace(conductor.legs.newest, number=10**9)}
    beat = conductor.beat()
    count = beat.count + changes.get("count", 1)
    host.figure.take_beat(replace(beat, **{**changes, "count": count}), host.now_ns())
    world.run(1.5)
    conductor.pause(world.now_ns)
    world.run(2.0)
    assert host.figure.beat.leg == conductor.legs.newest
    assert host.player.report.show_s == pytest.approx(conductor.legs.newest.show_s, abs=1e-9)
    conductor.stop(world.now_ns)
    assert world.run(2.0, lambda: host.figure.state == "stopped"), host.log


@pytest.mark.parametrize("epoch", [2, 10**9, 1 << 61])
def test_one_forged_status_does_not_supersede_a_conductor_whose_show_plays(epoch):
    world = playing(show_s=60.0)
    host = world.hosts["f1"]
    status = host.figure.status(host.now_ns())
    forged_one = replace(status, epoch=epoch, follows="e" * 16)
    world.conductor.take_status(forged_one, world.now_ns)
    world.run(2.0)
    assert world.conductor.superseded == ""
    world.conductor.seek(3.0, world.now_ns)


def test_a_forged_epoch_that_no_restarts_explain_is_refused_on_both_sides():
    world = World(2, seed=3)
    world.run(1.0)
    host = world.hosts["f1"]
    status = host.figure.status(host.now_ns())
    forged_one = replace(status, epoch=1 << 61, follows="e" * 16)
    world.conductor.take_status(forged_one, world.now_ns)
    assert world.conductor.epoch == 1
    world.is_conducting = False
    world.run(3.0)
    later = forged(world, instance="f" * 16, epoch=1 << 61)
    host.figure.take_beat(later, host.now_ns())
    assert host.figure.epoch == 1
    assert "no conductor has begun so often" in " ".join(host.figure.take_notes())


def test_strangers_do_not_fill_the_memory_of_a_figure():
    world = playing(show_s=60.0)
    host = world.hosts["f1"]
    world.is_conducting = False
    world.run(3.0)
    for number in range(3000):
        stale = forged(world, instance=f"{number:016x}", epoch=1)
        host.figure.take_beat(stale, host.now_ns())
        world.run(0.01)
    kept = host.figure._passed_over_ns, host.figure._refused
    assert max(map(len, kept)) <= 64


def test_second_and_stale_conductors_are_refused():
    world = playing()
    host = world.hosts["f1"]
    figure, leg = host.figure, world.conductor.legs.newest
    stopped = {"wanted": "stopped"}
    other = "0123456789abcdef"
    for beat, why in (
        (forged(world, instance=other, **stopped), "a second one with the epoch of the first"),
        (forged(world, instance=other, epoch=9, **stopped), "the first one .* still conducts"),
        (forged(world, conductor="f3", **stopped), "the stage file names f0"),
    ):
        figure.take_beat(beat, host.now_ns())
        world.run(0.5)
        assert figure.state == "playing"
        assert pytest.importorskip("re").search(why, " ".join(host.log))
    assert world.conductor.legs.newest == leg


def test_a_conductor_after_another_one_is_followed_without_a_word_about_its_epoch():
    world = playing(show_s=60.0)
    host = world.hosts["f1"]
    first = forged(world)
    world.is_conducting = False
    world.run(8.0)
    other = {"instance": "f" * 16, "wanted": "nothing", "leg": None, "count": 1}
    host.figure.take_beat(replace(first, **other), host.now_ns())
    world.run(0.3)
    host.figure.take_beat(replace(first, **{**other, "epoch": 2}), host.now_ns())
    world.run(0.3)
    assert "follows conductor f0 of epoch 2" in host.log
    assert "refused" not in " ".join(host.log)


def test_a_conductor_that_stays_at_an_old_epoch_is_named():
    world = playing(show_s=60.0)
    host = world.hosts["f1"]
    stale = forged(world, instance="f" * 16, wanted="nothing", leg=None)
    world.is_conducting = False
    world.run(8.0)
    for _ in range(12):
        host.figure.take_beat(stale, host.now_ns())
        world.run(0.1)
    assert " ".join(host.log).count("is refused: a second one with the epoch of the first") == 1


def test_a_second_conductor_that_began_later_does_not_end_the_show_of_the_first():
    world = playing()
    conductor = world.conductor
    later = forged(world, instance="f" * 16, epoch=9, wanted="nothing", leg=None)
    conductor.take_beat(later, world.now_ns)
    conductor.take_beat(later, world.now_ns)
    world.run(0.5)
    assert conductor.superseded == ""
    assert " ".join(world.notes).count("is refused: figures play what this one says") == 1
    conductor.take_beat(later, world.now_ns + 2 * 10**9)  # It slept, and no figure follows it.
    assert "conducts no more" in conductor.superseded


def test_a_conductor_that_comes_back_from_the_past_conducts_no_more():
    world = playing(show_s=60.0)
    stale = forged(world)
    world.is_conducting = False
    world.run(6.0)
    for host in world.hosts.values():  # Another process, which began later.
        host.figure.take_beat(
            replace(stale, epoch=2, instance="f" * 16, wanted="ready", leg=None),
            host.now_ns(),
        )
    world.run(0.5)
    world.is_conducting = True
    world.run(2.0)
    assert "began later (epoch 2" in world.conductor.superseded
    assert "it is stale" in " ".join(world.hosts["f1"].log)
    with pytest.raises(InputError, match="conducts no more"):
        world.conductor.seek(3.0, world.now_ns)
    assert {host.player.does for host in world.hosts.values()} <= {"none", "stopping"}


def test_a_clock_that_jumps_in_the_show_is_followed():
    world = playing(show_s=60.0)
    host = world.hosts["f2"]
    host.clock.jumps.append((world.now_ns + NS_PER_S, 250 * NS_PER_MS))
    world.run(6.0)
    follow = host.player.follows[-1][1]
    true_ns = follow.instant_ns - host.clock.own_ns(0) - 250 * NS_PER_MS
    assert host.estimator.restarts == 1
    leg_s = world.conductor.legs.newest.at_s(round(true_ns))
    assert follow.show_s == pytest.approx(leg_s, abs=0.003)
