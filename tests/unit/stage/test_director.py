"""The director by table: every start mode, every refusal with its reason, rests and faults."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from random import Random

import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.robot.on_fault import Cause
from lss_motion.stage import orders
from lss_motion.stage.director import Director, ShowInfo
from lss_motion.stage.file import Budget, Retry
from lss_motion.stage.model import (
    CueTrigger,
    DutyRule,
    LogRule,
    Signal,
    Stage,
    StageCue,
    StageShow,
    TriggerKind,
)
from lss_motion.units import NS_PER_S
from tests.tables import titled

NOON = datetime(2026, 7, 3, 12, 0, tzinfo=UTC)
SHOWS = {
    "idle": ShowInfo(joints=frozenset({"neck"}), duration_s=math.inf),
    "a": ShowInfo(joints=frozenset({"neck", "jaw"}), duration_s=10.0),
    "b": ShowInfo(joints=frozenset({"neck", "jaw"}), duration_s=10.0),
    "wink": ShowInfo(joints=frozenset({"lid"}), duration_s=1.0),
    "jaw": ShowInfo(joints=frozenset({"jaw"}), duration_s=1.0),
    "sleep": ShowInfo(joints=frozenset({"neck", "jaw"}), duration_s=3.0),
}


def key(name, **other):
    show = other.pop("play", "a")
    shows = (show,) if isinstance(show, str) else tuple(show or ())
    return StageCue(
        name=name, on=CueTrigger(kind=TriggerKind.KEY, address=name), shows=shows, **other
    )


class DirectorDesk:
    """A director with a player that obeys at once, and a clock."""

    def __init__(self, *cues, idle="idle", begins=True, seed=1, director=(), **stage):
        folder = Path("nowhere")
        self.stage = Stage(
            name="hall",
            path=folder / "stage.yaml",
            robot_path=None,
            shows={name: StageShow(name=name, paths={"": folder}) for name in SHOWS},
            idle=idle,
            cues=cues,
            log=LogRule(folder=folder),
            zone=UTC,
            **stage,
        )
        self.director = Director(self.stage, SHOWS, Random(seed), **dict(director))
        self.now_ns, self.wall = 0, NOON
        self.playing: dict[int, str] = {}
        self.plays: list[orders.PlayOrder] = []
        self.notes: list[str] = []
        self.others: list[object] = []
        self.wait(0)
        if begins:
            self.director.connected(self.now_ns)
            self.obey()

    def wait(self, span_s, step_s=1.0):
        end_ns = self.now_ns + round(span_s * NS_PER_S)
        while True:
            self.director.tick(self.now_ns, self.wall)
            self.obey()
            if self.now_ns >= end_ns:
                return
            step_ns = min(round(step_s * NS_PER_S), end_ns - self.now_ns)
            self.now_ns += step_ns
            self.wall += timedelta(seconds=step_ns / NS_PER_S)

    def press(self, *names):
        for name in names:
            self.signal(Signal(kind=TriggerKind.KEY, address=name))
            self.wait(0.5)

    def signal(self, signal):
        self.director.signal(signal, self.now_ns)
        self.obey()

    def finish(self, show, outcome="finished", show_s=None):
        number = next(n for n, name in self.playing.items() if name == show)
        del self.playing[number]
        self.director.ended(number, outcome, show_s, self.now_ns)
        self.obey()

    def obey(self):
        while (order := self.director.next_order()) is not None:
            match order:
                case orders.PlayOrder():
                    self.plays.append(order)
                    if order.how == "change":
                        self.leave_all()
                    self.playing[order.number] = order.show
                case orders.StopOrder():
                    self.leave_all()
                    self.others.append(order)
                case orders.Note() if order.kind != "alert":
                    self.notes.append(order.text)
                case _:
                    self.others.append(order)

    def leave_all(self):
        left, self.playing = self.playing, {}
        for number in left:
            self.director.ended(number, "left", 4.0, self.now_ns)

    def script(self, text):
        """Do and compare, word by word.

        `x` presses key x, `GO` is GO, `15s` waits, `-a` ends show a, `=a+wink` is what plays now,
        `x:a_plays` why cue x was refused; `x:` says that it was not.
        """
        for word in text.split():
            if word == "GO":
                self.signal(Signal(kind=TriggerKind.GO))
            elif word[0] == "-":
                self.finish(word[1:])
            elif word[0] == "=":
                assert (word, "+".join(self.shown)) == (word, word[1:])
            elif ":" in word:
                cue, reason = word.split(":", 1)
                assert self.refusal(cue) == reason.replace("_", " "), word
            elif word[-1] == "s" and word[:-1].isdigit():
                self.wait(int(word[:-1]))
            else:
                self.press(word)

    @property
    def shown(self):
        return sorted(self.playing.values())

    def refusal(self, cue):
        """Return why `cue` was refused last; empty if its last trigger was not."""
        last = [n for n in self.notes if n.startswith((f"cue {cue}:", f"cue {cue} refused"))][-1]
        return last.split("refused: ")[1].split(" (")[0] if "refused" in last else ""


# ---- scripts


def starts(start, show="b", **other):
    """Return the key x for show a, and y for another one."""
    return key("x"), key("y", play=show, start=start, **other)


IDLE_GIVES_WAY = "=idle y =b -b =idle"
SCRIPTS = {
    "only_if_idle while a show plays": (starts("only_if_idle"), "x y =a y:a_plays"),
    "add while other joints play": (starts("add", "wink"), "x y =a+wink y:"),
    "add while its joints play": (starts("add", "jaw"), "x y =a y:jaw_in_use_by_a"),
    "interrupt while a show plays": (starts("interrupt"), "x y =b y:"),
    "terminate while a show plays": (starts("terminate"), "x y =b y:"),
    "restart while another plays": (starts("restart"), "x y =a y:a_plays"),
    "restart while it plays": (starts("restart", "a"), "x y =a y:"),
    "queue while a show plays": (starts("queue"), "x y =a y:"),
    **{
        f"the idle show gives way to {start} and comes back": (starts(start), IDLE_GIVES_WAY)
        for start in ("only_if_idle", "interrupt", "terminate", "restart", "queue")
    },
    "an added show leaves the idle show alone": (
        (key("x"), key("w", play="wink", start="add")),
        "w =idle+wink x x:wink_plays =idle+wink -wink x =a",
    ),
    "terminate also drops what waits": (
        (
            key("x"),
            key("q", play="b", start="queue"),
            key("i", play="jaw", start="interrupt"),
            key("t", play="sleep", start="terminate"),
        ),
        "x q i t =sleep -sleep =idle",
    ),
    "the queue is played by priority, then in order, and each cue waits once": (
        (
            key("x"),
            key("p", play="jaw", start="queue"),
            key("q", play="b", start="queue"),
            key("r", play="sleep", start="queue", priority=3),
        ),
        "x p q r q q:it_is_in_the_queue =a -a =sleep -sleep =jaw -jaw =b -b =idle",
    ),
    **{
        f"a lower priority does not {start}": (
            (key("x", priority=2), key("y", play="b", start=start, priority=1)),
            "x y =a y:a_plays_with_priority_2",
        )
        for start in ("interrupt", "terminate")
    },
    "a cooldown begins when the show has ended": (
        (key("x", cooldown_s=20.0, start="terminate"),),
        "x x x:its_show_waits_or_plays,_and_it_has_a_cooldown -a 15s "
        "x x:cooldown,_for_another_5.0_s 5s x =a",
    ),
    "a refused cue does not use up its turn": (
        (key("x", play=["a", "b"]), key("y", play="sleep")),
        "y x -sleep x =a",
    ),
}


@titled(("cues", "text"), SCRIPTS)
def test_a_stage_does(cues, text):
    DirectorDesk(*cues).script(text)


def test_a_stage_that_waits_for_go_moves_nothing_before():
    desk = DirectorDesk(key("x"), director={"waits_for_go": True}.items())
    desk.script("x x:the_figure_rests:_waits_for_GO = GO =idle")
    assert [play.show for play in desk.plays] == ["idle"]


def test_an_interrupted_show_goes_on_where_it_was():
    desk = DirectorDesk(key("x"), key("y", play="b", start="interrupt"))
    desk.press("x", "y")
    assert desk.shown == ["b"]
    desk.finish("b")
    assert desk.shown == ["a"]
    assert desk.plays[-1].start_s == 4.0
    desk.finish("a")
    assert desk.shown == ["idle"]


# ---- other refusals, and choices


def test_a_button_that_bounces_is_pressed_once():
    desk = DirectorDesk(key("x", start="restart"))
    for _ in range(5):
        desk.signal(Signal(kind=TriggerKind.KEY, address="x"))
    assert desk.refusal("x") == "it has fired just before"
    assert [play.show for play in desk.plays] == ["idle", "a"]


def test_cues_enable_and_disable_each_other():
    desk = DirectorDesk(
        key("x", is_enabled=False), key("on", play=(), enables=("x",), disables=("on",))
    )
    desk.press("x")
    assert desk.refusal("x") == "it is disabled"
    desk.press("on", "x")
    assert desk.shown == ["a"]
    desk.press("on")
    assert desk.refusal("on") == "it is disabled"
    with pytest.raises(InputError, match="no cue 'y'; there are: x, on"):
        desk.director.enable("y", is_enabled=True)


def test_random_plays_each_show_once_before_any_again_and_none_twice_in_a_row():
    desk = DirectorDesk(key("x", play=["a", "b", "sleep"], choice="random"), seed=4)
    found = []
    for _ in range(60):
        desk.press("x")
        found += desk.shown
        desk.finish(found[-1])
    rounds = [tuple(found[i : i + 3]) for i in range(0, 60, 3)]
    assert all(sorted(one) == ["a", "b", "sleep"] for one in rounds)
    assert len(set(rounds)) > 3
    assert all(one != two for one, two in pairwise(found))


def test_the_end_of_a_show_is_a_trigger_before_the_idle_show():
    chain = StageCue(name="next", on=CueTrigger(kind=TriggerKind.END_OF, address="a"), shows=("b",))
    desk = DirectorDesk(key("x"), chain)
    desk.press("x")
    desk.wait(5)
    desk.finish("a")
    assert desk.shown == ["b"]
    assert [play.show for play in desk.plays] == ["idle", "a", "b"]


def test_a_show_that_cannot_be_played_is_refused_with_the_reason_of_the_player():
    desk = DirectorDesk(key("x"), key("w", play="wink", start="add"))
    desk.press("w")
    number = next(n for n, show in desk.playing.items() if show == "wink")
    del desk.playing[number]
    desk.director.refused(number, "the line has no room", desk.now_ns)
    desk.obey()
    assert desk.refusal("w") == "the line has no room"
    assert desk.shown == ["idle"]


# ---- GO, start


def test_go_fires_its_cues_in_turn_is_debounced_and_can_be_armed():
    goes = [
        StageCue(name=n, on=CueTrigger(kind=TriggerKind.GO), shows=(n,), start="terminate")
        for n in "ab"
    ]
    desk = DirectorDesk(*goes, key("y", play="sleep", start="terminate"))
    for expected in ("a", "b", "a"):
        assert desk.director.next_go() == expected
        desk.signal(Signal(kind=TriggerKind.GO))
        assert desk.shown == [expected]
        desk.signal(Signal(kind=TriggerKind.GO))
        assert desk.shown == [expected]
        desk.wait(1)
    desk.director.arm("y")
    desk.signal(Signal(kind=TriggerKind.GO))
    assert desk.shown == ["sleep"]
    assert desk.director.next_go() == "a"


def test_a_stage_begins_at_its_instant():
    desk = DirectorDesk(key("x"), director={"start_at": NOON + timedelta(seconds=30)}.items())
    desk.wait(29)
    assert desk.plays == []
    desk.wait(1)
    assert desk.shown == ["idle"]


def test_the_start_of_the_stage_is_a_trigger_once():
    first = StageCue(name="first", on=CueTrigger(kind=TriggerKind.START), shows=("a",))
    desk = DirectorDesk(first)
    assert desk.shown == ["a"]
    desk.director.faulted(Cause.SILENT, "gone", desk.now_ns)
    desk.playing.clear()
    desk.wait(11)
    assert orders.ConnectOrder() in desk.others
    desk.director.connected(desk.now_ns)
    desk.obey()
    assert desk.shown == ["idle"]


# ---- sensors and levels


def reading(value):
    return Signal(kind=TriggerKind.SENSOR, address="door", value=value)


def test_a_sensor_fires_once_when_two_readings_in_a_row_meet_its_condition():
    on = CueTrigger(kind=TriggerKind.SENSOR, address="door", side="below", threshold=800.0)
    desk = DirectorDesk(StageCue(name="v", on=on, shows=("a",), start="terminate"))
    counts = []
    for value in (900, 700, 900, 700, 700, 600, 900, 600, 600, 900, 900, 700, 700):
        desk.signal(reading(value))
        desk.wait(0.4)
        counts.append(len(desk.plays) - 1)
    assert counts == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 2]


def test_a_button_by_osc_fires_when_it_is_pressed_and_a_fader_when_it_passes():
    push = StageCue(
        name="p", on=CueTrigger(kind=TriggerKind.OSC, address="/go"), shows=("a",), start="restart"
    )
    fader = replace(push, name="f", on=replace(push.on, address="/f", side="above", threshold=0.5))
    desk = DirectorDesk(push, fader)
    for address, value in [("/go", 1.0), ("/go", 0.0), ("/go", None), ("/f", 0.4), ("/f", 0.6)]:
        desk.signal(Signal(kind=TriggerKind.OSC, address=address, value=value))
        desk.wait(1)
    for value in (0.7, 0.8, 0.2, 0.9):
        desk.signal(Signal(kind=TriggerKind.OSC, address="/f", value=value))
        desk.wait(1)
    fired = [note.split(":")[0] for note in desk.notes if note.startswith("cue")]
    assert fired == ["cue p", "cue p", "cue f", "cue f"]


# ---- duty, budgets, quiet hours


def test_after_work_the_figure_rests_when_its_show_has_ended_and_goes_limp():
    duty = DutyRule(work_s=60.0, rest_s=100.0, rest="sleep", is_limp=True)
    desk = DirectorDesk(key("x"), duty=duty)
    desk.wait(55)
    desk.press("x")
    desk.wait(10)
    assert desk.shown == ["a"]
    desk.finish("a")
    assert desk.shown == ["sleep"]
    desk.press("x")
    assert desk.refusal("x").startswith("the figure rests: has worked long enough")
    assert desk.others == []
    desk.finish("sleep")
    assert desk.others == [orders.RelaxOrder()]
    desk.wait(100)
    assert desk.shown == ["idle"]


def test_a_hot_servo_slows_the_shows_then_ends_them_until_it_is_cool():
    desk = DirectorDesk(key("x"), duty=DutyRule(temperature_c=Budget(slow=55, rest=65)))
    desk.press("x")
    for celsius, rate in [(50, 1.0), (56, 0.5), (54, 0.5), (52, 1.0), (66, 0.5)]:
        desk.director.measured(celsius, None, desk.now_ns, "neck")
        desk.obey()
        assert desk.director.duty.rate == rate, celsius
    assert desk.shown == []
    desk.press("x")
    assert desk.refusal("x") == "the figure rests: a servo is hot"
    desk.director.measured(54, None, desk.now_ns, "neck")
    desk.obey()
    assert desk.shown == ["idle"]


def test_a_peak_of_current_is_no_reason_to_rest_but_a_minute_of_it_is():
    desk = DirectorDesk(duty=DutyRule(current_a=Budget(slow=2.0, rest=3.0)))
    for second in range(120):
        desk.director.measured(None, 20.0 if second == 5 else 1.0, desk.now_ns)
        desk.wait(1)
    assert desk.shown == ["idle"]
    for _ in range(180):
        desk.director.measured(None, 4.0, desk.now_ns)
        desk.wait(1)
    assert desk.shown == []


def test_quiet_hours_begin_after_the_show_and_end():
    quiet = DutyRule(quiet=((NOON.time(), (NOON + timedelta(hours=1)).time()),), rest="sleep")
    desk = DirectorDesk(key("x"), duty=quiet)
    assert desk.shown == ["sleep"]
    desk.press("x")
    assert desk.refusal("x") == "the figure rests: quiet hours"
    assert list(desk.director.duty.reasons.values()) == ["quiet hours (until 13:00)"]
    desk.finish("sleep")
    desk.wait(3600, step_s=30)
    assert desk.shown == ["idle"]


def test_an_operator_stops_all_sends_to_rest_and_wakes():
    desk = DirectorDesk(key("x"), key("q", play="b", start="queue"), duty=DutyRule(rest="sleep"))
    desk.press("x", "q")
    desk.director.do("stop", desk.now_ns)
    desk.obey()
    assert desk.shown == ["idle"]
    desk.director.do("rest", desk.now_ns)
    desk.obey()
    assert desk.shown == ["sleep"]
    desk.director.do("wake", desk.now_ns)
    desk.obey()
    assert desk.shown == ["idle"]
    desk.director.play("b", desk.now_ns)
    desk.obey()
    assert desk.shown == ["b"]


# ---- faults


def test_after_a_fault_the_stage_begins_again_a_bounded_number_of_times():
    desk = DirectorDesk(key("x"), retry=Retry(attempts={Cause.SILENT: 3}, wait_s=10.0))
    waits = []
    for _ in range(3):
        desk.press("x")
        desk.director.faulted(Cause.SILENT, "joint 'jaw' is silent", desk.now_ns)
        desk.playing.clear()
        desk.obey()
        from_ns, desk.others = desk.now_ns, []
        desk.press("x")
        assert "waits after a fault" in desk.refusal("x")
        while orders.ConnectOrder() not in desk.others:
            desk.wait(1)
        waits.append(round((desk.now_ns - from_ns) / NS_PER_S))
        desk.director.connected(desk.now_ns)
        desk.obey()
        assert desk.shown == ["idle"]
    assert waits == pytest.approx([10, 20, 40], abs=1)
    desk.others.clear()
    desk.director.faulted(Cause.SILENT, "joint 'jaw' is silent", desk.now_ns)
    desk.playing.clear()
    desk.wait(7200, step_s=60)
    assert [one.fields["alert"] for one in desk.others] == ["given_up"]
    desk.press("x")
    assert "too many faults" in desk.refusal("x")
    desk.director.do("wake", desk.now_ns)
    desk.obey()
    assert desk.others[-1] == orders.ConnectOrder()


def test_a_fault_that_does_not_come_back_by_itself_is_not_tried_again():
    desk = DirectorDesk(retry=Retry())
    desk.director.faulted(Cause.BLOCKED, "joint 'jaw' is blocked", desk.now_ns)
    desk.wait(3600, step_s=60)
    assert [one.fields["alert"] for one in desk.others] == ["given_up"]


def test_faults_of_all_kinds_are_bounded_together_and_forgotten_after_a_while():
    attempts = dict.fromkeys(Cause, 3)
    desk = DirectorDesk(retry=Retry(attempts=attempts, total=2, within_s=600.0, wait_s=1.0))

    def fault(cause):
        desk.director.faulted(cause, "fault", desk.now_ns)
        desk.others.clear()
        desk.playing.clear()
        desk.wait(5)
        if orders.ConnectOrder() not in desk.others:
            return False
        desk.director.connected(desk.now_ns)
        desk.obey()
        return True

    assert [fault(Cause.SILENT), fault(Cause.STUCK)] == [True, True]
    desk.wait(600, step_s=10)
    assert [fault(Cause.SILENT), fault(Cause.SILENT), fault(Cause.ASTRAY)] == [True, True, False]


def test_readings_that_come_all_the_time_do_not_put_off_the_clock():
    desk = DirectorDesk(duty=DutyRule(work_s=10.0, rest_s=100.0))
    for _ in range(150):
        desk.now_ns += NS_PER_S // 10
        desk.signal(reading(900))
        if desk.now_ns >= desk.director.next_wakeup_ns():
            desk.director.tick(desk.now_ns, desk.wall)
            desk.obey()
    assert desk.shown == []


# ---- timecode


def timed(name, at_s, show):
    on = CueTrigger(kind=TriggerKind.TIMECODE, address=name, at_s=at_s)
    return StageCue(name=name, on=on, shows=(show,), start="terminate", follows=True)


def test_timecode_fires_cues_as_it_passes_and_starts_shows_in_their_middle_after_a_jump():
    desk = DirectorDesk(timed("one", 100.0, "a"), timed("two", 200.0, "b"))

    def run(from_s, to_s, rate=1.0):
        for step in range(round(abs(to_s - from_s)) + 1):
            desk.director.take_timecode(from_s + step * rate, rate, desk.now_ns)
            desk.obey()
            desk.wait(1)

    run(95, 99)
    assert desk.shown == ["a"], "passed between two positions"
    assert (desk.plays[-1].start_s, desk.plays[-1].follows_s) == (None, 100.0)
    run(203, 204)
    assert desk.plays[-1].show == "b"
    assert desk.plays[-1].start_s == pytest.approx(3.0)
    count = len(desk.plays)
    run(230, 190, rate=-1.0)
    assert len(desk.plays) == count, "nothing is passed backwards"
    desk.director.take_timecode(None, 0.0, desk.now_ns)
    desk.wait(20)
    assert len(desk.plays) == count


def test_between_two_positions_the_timecode_goes_on_at_its_rate():
    desk = DirectorDesk(timed("one", 101.5, "a"))
    desk.director.take_timecode(100.0, 1.0, desk.now_ns)
    desk.wait(1.4, step_s=0.1)
    assert desk.shown == ["idle"]
    desk.wait(0.2, step_s=0.1)
    assert desk.shown == ["a"]


def running(desk, from_s, to_s):
    """Let the timecode run, and the player get ready as `stage.stage_timecode` does, 5 s before."""
    for at_s in range(from_s, to_s + 1):
        desk.director.take_timecode(float(at_s), 1.0, desk.now_ns)
        desk.obey()
        ready(desk)
        desk.wait(1)


def ready(desk, within_s=5.0):
    coming = desk.director.coming(desk.now_ns)
    if coming is not None and coming[1] <= within_s:
        desk.director.get_ready(coming[0], desk.now_ns)
        desk.obey()


def test_a_show_that_follows_waits_at_its_beginning_and_fires_when_the_timecode_is_there():
    desk = DirectorDesk(replace(timed("one", 100.0, "a"), cooldown_s=600.0), key("x", play="b"))
    running(desk, 90, 98)
    (waiting,) = [play for play in desk.plays if play.show == "a"]
    assert (waiting.waits, waiting.follows_s, waiting.start_s) == (True, 100.0, None)
    desk.press("x")
    assert desk.refusal("x") == "a plays", "nobody takes it away while the timecode comes"
    running(desk, 99, 102)
    assert [note for note in desk.notes if note.startswith("cue one: ")] == [
        "cue one: plays a, in step (timecode one)"
    ]
    assert [play.show for play in desk.plays] == ["idle", "a"], "it is not begun again"
    desk.finish("a")
    desk.director.take_timecode(50.0, 1.0, desk.now_ns)
    running(desk, 95, 101)
    assert desk.refusal("one").startswith("cooldown"), "that of a show that was played"


def test_what_plays_is_not_left_early_for_a_show_that_follows():
    desk = DirectorDesk(timed("one", 100.0, "a"), key("x", play="b"))
    running(desk, 90, 92)
    desk.press("x")
    running(desk, 93, 98)
    assert desk.shown == ["b"]
    running(desk, 99, 101)
    assert desk.shown == ["a"]
    assert not desk.plays[-1].waits


def test_without_timecode_the_cue_that_is_ready_or_armed_waits_and_others_may_play():
    cues = replace(timed("one", 100.0, "a"), is_ready=True), timed("two", 200.0, "b")
    desk = DirectorDesk(*cues, key("x", play="sleep"))
    ready(desk)
    assert desk.shown == ["a"]
    number = desk.plays[-1].number
    assert desk.director.is_ready(number)
    assert desk.director.waits_on(number)
    desk.wait(4000)
    assert not desk.director.duty.reasons, "to wait is no work"
    desk.press("x")
    assert desk.shown == ["sleep"]
    desk.finish("sleep")
    assert desk.shown == ["idle"]
    desk.director.arm("two")
    ready(desk)
    assert desk.shown == ["b"]
    running(desk, 203, 204)
    assert "cue two: plays b, in step (timecode two)" in desk.notes
    assert desk.director.armed is None


def test_a_show_that_waits_is_begun_anew_with_newer_files():
    desk = DirectorDesk(replace(timed("one", 100.0, "a"), is_ready=True), key("x", play="b"))
    ready(desk)
    assert desk.director.is_free
    newer = replace(desk.stage, cues=(replace(timed("one", 90.0, "b"), is_ready=True),))
    desk.director.arm("x")
    desk.director.renew(newer, SHOWS, set())
    desk.obey()
    assert desk.shown == ["idle"]
    assert desk.director.armed is None, "that cue is gone"
    ready(desk)
    assert desk.shown == ["b"]
    assert desk.plays[-1].follows_s == 90.0
    running(desk, 86, 87)
    assert not desk.director.is_free, "it comes"


def test_timecode_of_another_show_ends_the_wait_and_starts_that_one():
    cues = replace(timed("one", 100.0, "a"), is_ready=True), timed("two", 90.0, "b")
    desk = DirectorDesk(*(replace(cue, start="only_if_idle") for cue in cues))
    ready(desk)
    desk.director.take_timecode(92.0, 1.0, desk.now_ns)
    desk.obey()
    assert desk.shown == ["b"]
    assert desk.plays[-1].start_s == pytest.approx(2.0)


# ---- time of day


def test_the_clock_may_be_set_in_mid_show_and_no_cue_fires_twice():
    every = StageCue(
        name="ten",
        on=CueTrigger(kind=TriggerKind.TIME, address="*/10 * * * *"),
        shows=("b",),
        start="add",
    )
    desk = DirectorDesk(every, key("x"))
    desk.press("x")
    desk.wait(700)
    desk.wall -= timedelta(seconds=400)
    desk.wait(500)
    fired = [note for note in desk.notes if note.startswith("cue ten")]
    assert len(fired) == 1
    assert desk.shown == ["a"]
    desk.wait(600)
    assert len([note for note in desk.notes if note.startswith("cue ten")]) == 2


TIMED = {
    "while no process ran": (60.0, 1.0, ["cue t"]),
    "while the robot was made ready": (0.0, 200.0, ["cue t"]),
    "long ago": (600.0, 1.0, []),
    "before the first process": (None, 1.0, []),
}


@titled(("gone_s", "ready_s", "fired"), TIMED)
def test_a_time_of_day_that_fell_into_a_restart_fires_when_the_robot_is_ready(
    gone_s, ready_s, fired
):
    on = CueTrigger(kind=TriggerKind.TIME, address="0 12 * * *" if gone_s else "3 12 * * *")
    seen = None if gone_s is None else NOON + timedelta(seconds=30 - gone_s)
    desk = DirectorDesk(
        StageCue(name="t", on=on, shows=("a",)), begins=False, director={"seen": seen}
    )
    desk.wall = NOON + timedelta(seconds=30)
    desk.wait(ready_s)
    assert [text for text in desk.notes if text.startswith("cue t")] == []
    desk.director.connected(desk.now_ns)
    desk.wait(2.0)
    assert [text[:5] for text in desk.notes if text.startswith("cue t")] == fired
    assert (desk.playing and "a" in desk.playing.values()) == bool(fired)
