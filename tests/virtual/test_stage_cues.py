"""A stage in virtual time: sensors, cues and faults of simulated robots, judged at their bytes."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

import pytest
from campaign.outside import objections_to
from campaign.witness import Witness

from lss_motion.errors import BusError, InputError
from lss_motion.playing import run as run_module
from lss_motion.robot.on_fault import Cause
from lss_motion.sim.faults import SENSOR_NAMES, Fault, FaultKind
from lss_motion.stage import running
from lss_motion.stage.check import plan_stage
from lss_motion.stage.load import load_stage
from lss_motion.stage.model import Signal, TriggerKind
from lss_motion.stage.running import Options, StageRun

S = 1_000_000_000
BEGINS = datetime(2026, 10, 30, 18, 0, tzinfo=UTC)

ROBOT = """\
robot: puppet
defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  neck: {id: 1, range_deg: [-90, 90]}
  jaw:  {id: 2, range_deg: [-90, 90]}
  lid:  {id: 3, range_deg: [-90, 90]}
sensors:
  door: {id: 203, kind: GP2Y0A21YK0F}
"""
SHOWS = {
    "idle": [{"neck": 0}, {"neck": 10}, {"neck": 0}],
    "scare": [{"neck": 0, "jaw": 0}, {"neck": 30, "jaw": 40}, {"neck": 0, "jaw": 0}],
    "wink": [{"lid": 0}, {"lid": 20}, {"lid": 0}],
    "sleep": [{"neck": 0, "jaw": 0}, {"neck": -30, "jaw": 0}],
}
STAGE = """\
stage: hall
robot: robot.yaml
shows: {idle: idle.yaml, scare: scare.yaml, sleep: sleep.yaml, wink: wink.yaml}
idle: idle
cues:
  - {cue: visitor, on: {sensor: door, below_mm: 500}, play: scare, cooldown_s: 5}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage")
    (path / "robot.yaml").write_text(ROBOT)
    for name, poses in SHOWS.items():
        frames = "\n".join(f"  - {{at_s: {i}, deg: {pose}}}" for i, pose in enumerate(poses))
        text = f"sequence: {name}\nkeyframes:\n{frames}\n".replace("'", "")
        (path / f"{name}.yaml").write_text(text)
    return path


class CueJudge(Witness):
    """Keeps all bytes of a run; virtual evenings are longer than a run of a campaign."""

    def act(self, driven, now_ns):
        self.end_ns = now_ns


def evening(
    folder,
    lasts_s,
    more="",
    faults=None,
    acts=(),
    judges=None,
    hands=None,
    begins=BEGINS,
    **options,
):
    """Play an evening; return how it ended, its records and its runs, each judged at its horns.

    `acts` are what operators do: `(at_s, function of the director and the instant)`.
    """
    (folder / "stage.yaml").write_text(STAGE + more)
    planned = plan_stage(load_stage(folder / "stage.yaml"))
    records, runs = [], []
    judges = [] if judges is None else judges

    def make_tap(_started_ns):
        judges.append(CueJudge())
        return judges[-1]

    def judge(result, began_ns):
        found = () if faults is None else faults(began_ns)
        judges[-1].end_ns = round(result.report.run_s * S)
        objections = objections_to(result.player.robot, found, judges[-1], result)
        assert objections == []
        runs.append((began_ns / S, result))

    options = Options(
        is_virtual=True,
        begins=begins,
        lasts_s=lasts_s,
        seed=1,
        next_faults=faults,
        **options,
    )
    hand = CueHand(list(acts))
    if hands is not None:
        hands.append(hand)
    run = StageRun(planned, options, steerer=hand, note=records.append, tap=make_tap)
    hand.run = run
    end = run.play(judge)
    run.note_counts(is_last=True)
    return end, records, runs


class CueHand:
    """An operator who acts at given times."""

    has_stopped, rate = False, 1.0

    def __init__(self, acts):
        self._acts, self.run = sorted(acts, key=lambda act: act[0]), None
        self.player = None

    def filenos(self):
        return ()

    def act(self, player, now_ns):
        self.player = player
        while self._acts and self._acts[0][0] * S <= self.run.now_ns:
            self._acts.pop(0)[1](self.run.director, self.run.now_ns)

    def on_event(self, event): ...

    def on_turn(self, player, now_ns): ...

    def note(self, record): ...


def kinds(records, *wanted):
    return [one["text"].split(" (")[0] for one in records if one["kind"] in wanted]


def near(at_s, to_s):
    raw = SENSOR_NAMES["GP2Y0A21YK0F"].raw(300.0)
    return Fault(kind=FaultKind.INPUT, servo_id=203, at_s=at_s, until_s=to_s, raw=raw)


def press(name):
    signal = Signal(kind=TriggerKind.CUE, address=name)
    return lambda director, now_ns: director.signal(signal, now_ns)


def test_a_visitor_at_the_sensor_is_scared_once_and_the_idle_show_comes_back(folder):
    end, records, runs = evening(folder, 25.0, faults=lambda _: [near(6.0, 20.0)])
    assert (end.runs, end.error) == (1, None)
    assert kinds(records, "fired", "over") == [
        "cue visitor: plays scare, only_if_idle",
        "idle left",
        "scare finished",
        "idle stopped",
    ]
    fired = next(one for one in records if one["kind"] == "fired")
    assert "18:00:06.0" <= fired["t"][11:21] <= "18:00:06.3", "two readings after the visitor"
    # The sensor is not a joint: its queries must not have displaced those of the servos.
    assert runs[0][1].report.totals["scare"].missed == 0


CUES = """\
  - {cue: over, on: {key: o}, play: scare, start: terminate}
  - {cue: between, on: {key: i}, play: sleep, start: interrupt}
  - {cue: later, on: {key: q}, play: scare, start: queue}
  - {cue: again, on: {key: r}, play: scare, start: restart}
  - {cue: blink, on: {key: a}, play: wink, start: add}
"""


def test_every_start_mode_at_the_horns(folder):
    """The judge of `evening` asserts that no limit is broken and nothing is stepped."""
    acts = [(at, press(name)) for at, name in [
        (2.0, "over"), (4.0, "between"), (5.2, "later"), (20.0, "again"), (22.3, "again"),
        (30.0, "blink"), (30.5, "over"), (37.0, "blink"),
    ]]  # fmt: skip
    _, records, runs = evening(folder, 45.0, CUES, acts=acts)
    assert kinds(records, "over") == [
        "idle left", "scare left", "sleep finished", "scare finished", "scare finished",
        "idle left", "scare left", "scare finished", "wink left", "idle left", "scare finished",
        "wink finished", "idle stopped",
    ]  # fmt: skip
    refused = [one for one in records if one["kind"] == "refused"]
    assert [one["reason"] for one in refused] == []
    assert {name for one in runs[0][1].report.totals for name in [one]} >= {"idle", "scare"}


def test_a_servo_that_goes_silent_again_and_again_ends_in_a_safe_rest(folder):
    silent = Fault(kind=FaultKind.DEAF, servo_id=2, at_s=4.0)
    more = "on_fault: {attempts: {silent: 2}, wait_s: 20}\n"
    acts = [(150.0, press("visitor"))]
    end, records, runs = evening(folder, 200.0, more, faults=lambda _: [silent], acts=acts)
    assert end.runs == 3
    alerts = [one["alert"] for one in records if one.get("kind") == "alert"]
    assert alerts == ["fault", "fault", "given_up"]
    begins = [began_s for began_s, _ in runs]
    assert begins[1] - begins[0] > 20.0
    assert begins[2] - begins[1] > 40.0
    assert [result.player.faults[-1].kind for _, result in runs] == [Cause.SILENT] * 3
    assert any("too many faults" in one["text"] for one in records if one.get("kind") == "refused")
    assert sum("dump" in one for one in records) >= 3
    dump = next(one["content"] for one in records if "dump" in one)
    assert "#2QD" in dump
    assert "Faulted" in dump


def test_a_resting_figure_is_limp_and_is_set_up_again_when_it_wakes(folder):
    more = "duty: {work_s: 20, rest_s: 30, rest: sleep, limp: true}\n"
    end, records, runs = evening(folder, 65.0, more, judges=(judges := []))
    assert (end.runs, end.error) == (2, None)
    assert [judge.sent_data["main"][-6:] for judge in judges] == [b"#254L\r", b"#254H\r"]
    assert "sleep finished" in kinds(records, "over")
    gap_s = runs[1][0] - (runs[0][0] + runs[0][1].report.run_s)
    assert 20.0 < gap_s <= 30.0


def test_a_hot_servo_slows_the_figure_then_sends_it_to_rest(folder):
    faults = [
        Fault(kind=FaultKind.HOT, servo_id=1, at_s=at_s, temperature_c=celsius)
        for at_s, celsius in [(5.0, 55.0), (15.0, 70.0), (35.0, 40.0)]
    ]
    more = "duty: {temperature_c: {slow: 50, rest: 60}, rest: sleep}\n"
    _, records, _ = evening(folder, 60.0, more, faults=lambda _: faults)
    assert kinds(records, "note")[0] == "plays at 50% of its speed, by budget"
    rests = [one["text"] for one in records if one["kind"] == "rest"]
    assert rests[0].startswith("rests: a servo is hot (neck 69.")
    assert rests[-1] == "works"
    assert "sleep finished" in kinds(records, "over")


def test_a_storm_of_triggers_costs_a_few_lines_of_log(folder):
    acts = [(2.0 + number * 0.01, press("visitor")) for number in range(3000)]
    _, records, _ = evening(folder, 35.0, acts=acts)
    about = [one for one in records if one["kind"] in ("fired", "refused")]
    assert sum(one.get("count", 1) for one in about) == 3000, "every trigger is accounted for"
    assert len(about) < 30


def test_a_missing_port_is_waited_for(folder, monkeypatch):
    planned = None
    tries = []

    def perform(*args, **options):
        tries.append(run.now_ns / S)
        if len(tries) < 4:
            raise BusError("no port /dev/ttyUSB0")
        return run_module.perform(*args, **options)

    (folder / "stage.yaml").write_text(STAGE)
    planned = plan_stage(load_stage(folder / "stage.yaml"))
    monkeypatch.setattr(running, "perform", perform)
    run = StageRun(planned, Options(is_virtual=True, waits_for_port=True, lasts_s=20.0))
    end = run.play()
    assert end.error is None
    assert tries == pytest.approx([0, 5, 10, 15], abs=0.1)
    run = StageRun(planned, Options(is_virtual=True, lasts_s=20.0))
    tries.clear()
    assert isinstance(run.play().error, BusError)


def test_a_cue_at_a_time_of_day_says_when_it_comes_before_anything_has_happened(folder):
    strikes = "  - {cue: strikes, on: {time: '0 * * * *'}, play: wink, start: add}\n"
    (folder / "stage.yaml").write_text(STAGE + strikes)
    options = Options(is_virtual=True, begins=BEGINS)
    run = StageRun(plan_stage(load_stage(folder / "stage.yaml")), options)
    assert run.state_of()["cues"][-1]["when"] == "next 19:00"


def test_a_hot_servo_is_remembered_when_another_show_begins(folder):
    """A show that has just begun has not measured all servos: that ends no rest."""
    hot = [Fault(kind=FaultKind.HOT, servo_id=2, at_s=4.0, temperature_c=72.0)]
    duty = "duty: {rest: sleep, temperature_c: {slow: 55, rest: 65}}\n"
    _, records, _ = evening(folder, 30.0, duty, faults=lambda _began_ns: hot)
    rests = [one["text"] for one in records if one["kind"] == "rest"]
    assert len(rests) == 1
    assert "a servo is hot" in rests[0]


@pytest.mark.slow
def test_a_clock_that_is_set_in_mid_show_moves_nothing_and_fires_nothing_twice(folder, monkeypatch):
    """The bytes are the same as with a clock that is right, to the nanosecond."""
    every = "  - {cue: two, on: {time: '*/2 * * * *'}, play: wink, start: add}\n"
    begins = BEGINS + timedelta(minutes=1)
    steps_s = ((5.0, 45.0), (14.0, -50.0), (50.0, 20.0), (60.0, -40.0))
    """At 18:01:05, in a show, it is 45 s late; and so on: the clock passes 18:02 three times."""
    right = StageRun.wall

    def wall(run):
        return right(run) + timedelta(seconds=sum(by for at, by in steps_s if run.now_ns >= at * S))

    found = []
    for is_set in (False, True):
        judges = []
        with monkeypatch.context() as patch:
            if is_set:
                patch.setattr(StageRun, "wall", wall)
            acts = [(4.5, lambda director, now_ns: director.play("scare", now_ns))]
            _, records, _ = evening(folder, 90.0, every, acts=acts, judges=judges, begins=begins)
        fired = [one["cue"] for one in records if one["kind"] == "fired" and one["cue"] == "two"]
        assert fired == ["two"]
        found.append((judges[0].writes["main"], records))
    until_ns = 45 * S  # Until the cue comes, which is when the clock says so.
    before, after = ([one for one in writes if one[0] < until_ns] for writes, _ in found)
    assert before == after
    assert len(before) > 1000
    said = [one["text"] for one in found[1][1] if one["kind"] == "note"]
    assert not any("clock" in text for text in said), "less than what is taken for a correction"


GO = "  - {cue: go, on: {key: g}, play: scare}"


def test_every_run_of_a_stage_calls_what_was_there_when_it_began(folder, tmp_path, monkeypatch):
    for file in folder.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    (tmp_path / "stage.yaml").write_text(STAGE)
    scare, tricks = tmp_path / "scare.yaml", tmp_path / "tricks.py"
    tricks.write_text("def boo(show):\n    pass\n")
    scare.write_text(scare.read_text() + "events:\n  - {at_s: 0.5, run: 'tricks:boo'}\n")
    planned = plan_stage(load_stage(tmp_path / "stage.yaml"))
    run = StageRun(planned, Options(is_virtual=True, may_run=True))
    called = []

    def noted(*_, modules, **__):
        called.append({one.path: one.data for one in modules})
        tricks.write_text("raise SystemExit\n")
        raise InputError("it ends here")

    monkeypatch.setattr(running, "perform", noted)
    for _ in range(2):
        run.play()
    assert called == [{str(tricks): b"def boo(show):\n    pass\n"}] * 2


def test_new_files_are_played_by_the_run_that_goes_on(folder, tmp_path):
    for file in folder.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    hands, found, judges = [], [], []

    def renew(name, old, new):
        def act(_director, _now_ns):
            path = tmp_path / f"{name}.yaml"
            assert old in path.read_text()
            path.write_text(path.read_text().replace(old, new))
            planned = plan_stage(load_stage(tmp_path / "stage.yaml"))
            found.append(hands[0].run.renew(planned, hands[0].player))

        return act

    def press(director, now_ns):
        director.signal(Signal(kind=TriggerKind.KEY, address="g"), now_ns)

    acts = [
        (2.0, press),  # Not a cue yet.
        (3.0, renew("stage", "cooldown_s: 5}", f"cooldown_s: 5}}\n{GO}")),
        (5.0, renew("scare", "jaw: 40", "jaw: 60")),
        (6.0, press),
        (7.0, renew("scare", "jaw: 60", "jaw: 50")),
        (14.0, renew("idle", "neck: 10", "neck: -12")),
        (20.0, renew("robot", "accel_max_deg_s2: 600", "accel_max_deg_s2: 500")),
    ]  # fmt: skip
    _, records, runs = evening(tmp_path, 24.0, acts=acts, hands=hands, judges=judges)
    assert [kind for kind, _ in found] == ["renewed", "renewed", "busy", "renewed", "must_restart"]
    assert found[1][1] == "new files are played from now on; changed: scare"
    assert "the robot" in found[4][1]
    assert len(runs) == 1
    fired = [one["cue"] for one in records if one["kind"] == "fired"]
    assert fired == ["go"]
    targets = {
        (servo_id, at_ns // S): int(found[1])
        for at_ns, data in judges[0].writes["main"]
        for servo_id in (1, 2)
        for found in re.finditer(rb"#%dD(-?\d+)T" % servo_id, data)
    }
    jaw = [target for (servo_id, _), target in targets.items() if servo_id == 2]
    assert 595 < max(jaw) < 650, "as the file said when it was fired"
    neck = [target for (servo_id, at_s), target in targets.items() if servo_id == 1 and at_s > 16]
    assert min(neck) <= -115, "the new idle show"
