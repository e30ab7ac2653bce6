"""Storms of triggers on the director: against a model of its own, and what always holds."""

from __future__ import annotations

import math
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from random import Random

from hypothesis import given, settings
from hypothesis import strategies as st

from lss_motion.robot.on_fault import Cause
from lss_motion.stage import orders
from lss_motion.stage.director import QUEUE_MAX, Director, ShowInfo
from lss_motion.stage.file import Budget
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

STARTS = ("only_if_idle", "add", "interrupt", "terminate", "restart", "queue")
JOINTS = {"idle": "n", "a": "nj", "b": "nj", "c": "l", "d": "jl", "sleep": "nj"}
INFOS = {
    name: ShowInfo(joints=frozenset(joints), duration_s=math.inf if name == "idle" else 9.0)
    for name, joints in JOINTS.items()
}


def stage_of(cues, **other):
    folder = Path("nowhere")
    return Stage(
        name="storm",
        path=folder,
        robot_path=None,
        shows={name: StageShow(name=name, paths={"": folder}) for name in JOINTS},
        idle="idle",
        cues=tuple(cues),
        log=LogRule(folder=folder),
        zone=UTC,
        **other,
    )


class Model:
    """The start modes as sentences about lists; no code of the director.

    `stack` has the main show, if there is one, `under` those that were interrupted: (cue, show).
    """

    def __init__(self, cues):
        self.cues = {cue.name: cue for cue in cues}
        self.stack: list[tuple[str, str]] = []
        self.under: list[tuple[str, str]] = []
        self.beside: list[tuple[str, str]] = []
        self.line: list[tuple[str, str]] = []
        self.is_idle = True
        self.ready_s = dict.fromkeys(self.cues, 0.0)
        self.pressed_s = dict.fromkeys(self.cues, -1.0)

    def shown(self):
        main = [self.stack[-1][1]] if self.stack else ["idle"] * self.is_idle
        return sorted([*main, *(show for _, show in self.beside)])

    def press(self, name, now_s):
        """Return whether the cue fires."""
        cue, show = self.cues[name], self.cues[name].shows[0]
        if now_s - self.pressed_s[name] < 0.3 or now_s < self.ready_s[name]:
            return False
        mode = cue.start
        if mode == "restart" and [one[1] for one in self.stack] != [show]:
            mode = "only_if_idle"
        ranks = [self.cues[other].priority for other, _ in (*self.stack, *self.beside)]
        is_outranked = max(ranks, default=-999) > cue.priority
        fires = self.may(mode, name, show, is_outranked=is_outranked)
        if fires:
            self.start(mode, name, show, now_s)
        self.serve(now_s)
        if fires:
            self.pressed_s[name] = now_s
            if cue.cooldown_s:
                self.ready_s[name] = math.inf
        return fires

    def may(self, mode, name, show, *, is_outranked):
        if mode == "add":
            used = set("".join(JOINTS[one] for one in self.shown()))
            return show not in self.shown() and not used & set(JOINTS[show])
        if mode == "queue":
            waits = [other for other, _ in self.line]
            return name not in waits and len(waits) < QUEUE_MAX
        if mode == "only_if_idle":
            return not self.stack and not self.beside
        if mode == "interrupt" and self.stack:
            return self.stack[0][0] != name and len(self.under) < 4 and not is_outranked
        return not is_outranked

    def start(self, mode, name, show, now_s):
        if mode in ("add", "queue"):
            (self.beside if mode == "add" else self.line).append((name, show))
            return
        gone = list(self.beside)
        if mode == "interrupt":
            self.under += self.stack
        else:
            gone += self.stack
        if mode == "terminate":
            gone += self.line + self.under
            self.line, self.under = [], []
        self.stack, self.beside = [(name, show)], []
        self.over(gone, now_s)

    def over(self, ones, now_s):
        for name, _ in ones:
            self.ready_s[name] = now_s + self.cues[name].cooldown_s

    def finish(self, show, now_s):
        found = next(one for one in (*self.stack[-1:], *self.beside) if one[1] == show)
        (self.stack if found in self.stack[-1:] else self.beside).remove(found)
        self.over([found], now_s)
        self.serve(now_s)

    def serve(self, now_s):
        """When nothing plays, what was interrupted comes first, then the queue."""
        if self.under and not self.beside and not self.stack:
            self.stack.append(self.under.pop())
        if self.line and not self.beside and not self.stack:
            best = max(self.line, key=lambda one: self.cues[one[0]].priority)
            self.line.remove(best)
            self.stack.append(best)
        self.is_idle = not self.stack and (self.is_idle or not self.beside)


class StormDesk:
    """Obeys the director, and keeps what plays."""

    def __init__(self, stage, seed=0):
        self.director = Director(stage, INFOS, Random(seed))
        self.now_ns = 0
        self.wall = datetime(2026, 5, 1, 12, 0, tzinfo=UTC)
        self.playing: dict[int, orders.PlayOrder] = {}
        self.notes: list[orders.Note] = []
        self.connects = 0
        self.orders = 0
        self.on_play = lambda order: None
        self.director.tick(0, self.wall)
        self.director.connected(0)
        self.obey()

    def obey(self):
        while (order := self.director.next_order()) is not None:
            self.orders += 1
            if isinstance(order, orders.PlayOrder):
                self.on_play(order)
            if isinstance(order, orders.StopOrder) or getattr(order, "how", "") == "change":
                left, self.playing = self.playing, {}
                for number in left:
                    self.director.ended(number, "left", 1.0, self.now_ns)
            if isinstance(order, orders.PlayOrder):
                self.playing[order.number] = order
            self.connects += isinstance(order, orders.ConnectOrder)
            if isinstance(order, orders.Note):
                self.notes.append(order)

    def wait(self, span_s):
        self.now_ns += round(span_s * NS_PER_S)
        self.wall += timedelta(seconds=span_s)
        self.director.tick(self.now_ns, self.wall)
        self.obey()

    @property
    def shown(self):
        return sorted(play.show for play in self.playing.values())


cues_strategy = st.lists(
    st.tuples(
        st.sampled_from(STARTS),
        st.sampled_from(["a", "b", "c", "d"]),
        st.integers(0, 2),
        st.sampled_from([0.0, 0.0, 2.0]),
    ),
    min_size=1,
    max_size=6,
)
acts_strategy = st.lists(
    st.tuples(st.sampled_from(["press"] * 4 + ["finish", "wait"]), st.integers(0, 9)),
    max_size=60,
)


@settings(max_examples=2 * settings().max_examples)
@given(cues_strategy, acts_strategy)
def test_the_start_modes_do_what_a_model_of_them_does(made, acts):
    cues = [
        StageCue(
            name=f"k{number}",
            on=CueTrigger(kind=TriggerKind.KEY, address=f"k{number}"),
            shows=(show,),
            start=start,
            priority=priority,
            cooldown_s=cooldown_s,
        )
        for number, (start, show, priority, cooldown_s) in enumerate(made)
    ]
    desk, model = StormDesk(stage_of(cues)), Model(cues)
    for act, number in acts:
        now_s = desk.now_ns / NS_PER_S
        if act == "wait":
            desk.wait(0.1 + 0.3 * number)
            continue
        if act == "finish":
            ends = [n for n, play in desk.playing.items() if play.show != "idle"]
            if not ends:
                continue
            play = desk.playing.pop(ends[number % len(ends)])
            desk.director.ended(play.number, "finished", None, desk.now_ns)
            desk.obey()
            model.finish(play.show, now_s)
        else:
            name = cues[number % len(cues)].name
            desk.notes.clear()
            desk.director.signal(Signal(kind=TriggerKind.KEY, address=name), desk.now_ns)
            desk.obey()
            heard = [n for n in desk.notes if n.kind in ("fired", "refused")]
            assert [one.fields["cue"] for one in heard] == [name], "each trigger ends in one note"
            assert (heard[0].kind == "fired") is model.press(name, now_s), heard[0].text
        assert desk.shown == model.shown()


EVENTS = ("press", "press", "press", "finish", "wait", "fault", "hot", "clock", "refuse", "do")


@settings(max_examples=2 * settings().max_examples)
@given(
    cues_strategy, st.lists(st.tuples(st.sampled_from(EVENTS), st.integers(0, 99)), max_size=120)
)
def test_in_any_storm_joints_have_one_show_rests_are_kept_and_every_trigger_is_explained(
    made, events
):
    cues = [
        StageCue(
            name=f"k{number}",
            on=CueTrigger(kind=TriggerKind.KEY, address="k"),
            shows=(show, "a"),
            choice="random",
            start=start,
            priority=priority,
            cooldown_s=cooldown_s,
        )
        for number, (start, show, priority, cooldown_s) in enumerate(made)
    ]
    duty = DutyRule(
        work_s=300.0,
        rest_s=60.0,
        rest="sleep",
        temperature_c=Budget(slow=50, rest=60),
        quiet=((time(13), time(14)),),
    )
    desk = StormDesk(stage_of(cues, duty=duty))

    def check(play):
        assert desk.director.is_connected
        if desk.director.duty.reasons:
            assert play.show == "sleep"

    desk.on_play = check
    for event, number in events:
        desk.notes.clear()
        act(desk, event, number)
        desk.wait(0)
        used = [joint for play in desk.playing.values() for joint in JOINTS[play.show]]
        assert len(used) == len(set(used))
        assert len(desk.director.queue) <= QUEUE_MAX
        heard = [n for n in desk.notes if n.kind in ("fired", "refused")]
        if event == "press":
            assert [one.fields["cue"] for one in heard] == [cue.name for cue in cues]
    assert desk.orders < 60 + 40 * len(events)


def act(desk, event, number):  # noqa: C901  (a table)
    director, numbers = desk.director, list(desk.playing)
    match event:
        case "press":
            director.signal(Signal(kind=TriggerKind.KEY, address="k"), desk.now_ns)
        case "finish" | "refuse" if numbers:
            play = desk.playing.pop(numbers[number % len(numbers)])
            if event == "finish":
                director.ended(play.number, "finished", None, desk.now_ns)
            else:
                director.refused(play.number, "no room", desk.now_ns)
        case "wait":
            desk.wait(number * 3)
        case "fault":
            desk.playing.clear()
            director.faulted(list(Cause)[number % len(Cause)], "a fault", desk.now_ns)
            if number % 3 == 0:
                director.do("wake", desk.now_ns)
            before = desk.connects
            desk.obey()
            desk.wait(number)
            if desk.connects > before:
                director.connected(desk.now_ns)
        case "hot":
            director.measured(30.0 + number / 2, None, desk.now_ns, "n")
        case "clock":
            desk.wall += timedelta(minutes=number - 50)
        case "do":
            director.do(("stop", "rest", "wake")[number % 3], desk.now_ns)
    desk.obey()
