"""Scripts that use the package from Python, each a step of a case: `script NAME ARGUMENT…`.

They use the public names, and for stages `freezing.inside`. What they print is compared.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any, Final

from freezing import inside

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

EVENING: Final = [
    (4.0, "key", "h"), (7.5, "osc", "/scare"), (9.0, "key", "w"), (12.0, "key", "x"),
    (16.0, "cue", "hi"), (16.2, "key", "h"), (23.0, "go", ""), (25.0, "disable", "hi"),
    (26.0, "key", "h"), (27.0, "enable", "hi"), (28.0, "note", "60"), (30.0, "play", "scare"),
    (36.0, "rest", ""), (44.0, "wake", ""), (52.0, "cue", "nothing"), (54.0, "http", "late"),
    (56.0, "key", "h"), (60.0, "stop", ""),
]  # fmt: skip
"""What arrives from outside in an evening: when, by which trigger, from which address."""


def run(name: str, *arguments: str) -> int:
    """Run a script; what a user would see as an error goes to standard error."""
    import lss_motion as lss

    script: Callable[..., None] = {
        one.__name__: one for one in (connect, play, start, wrong, evening, duet)
    }[name]
    try:
        script(*arguments)
    except lss.LssMotionError as error:
        _tell(error)
        return 1
    return 0


def _tell(error: BaseException) -> None:
    for one in (error, *getattr(error, "more", ())):
        print(f"{type(error).__name__}: {one}", file=sys.stderr)


def _each(*calls: Callable[[], object]) -> None:
    """Print what each call returns, or the error that it raises."""
    import lss_motion as lss

    for call in calls:
        try:
            print(call())
        except (lss.LssMotionError, TypeError, ValueError) as error:
            _tell(error)


def connect(path: str, first: str, second: str) -> None:
    """Move, read, let go and hold the joints of a robot."""
    import lss_motion as lss

    with lss.connect(lss.load_robot(path), is_virtual=True, seed=3) as live:
        _each(
            live.read,
            lambda: live.move_to({first: 20.0}, 1.0),
            lambda: live.move_to({first: -10.0, second: 15.0}),
            live.read,
            lambda: live.limp(second),
            lambda: live,
            lambda: live.move_to({first: 5.0}, 0.2),
            lambda: live.hold(second),
            lambda: live.move_to({second: 0.0}, 2.0),
            lambda: live.move_to({first: 500.0}, 1.0),
            lambda: live.move_to({"elbwo": 5.0}, 1.0),
            lambda: live.move_to({}, 1.0),
            lambda: live.move_to({first: 1.0}, 0.0),
            lambda: live.limp("nobody"),
            live.read,
            lambda: live.warnings,
        )
    _each(live.read)


def _program(path: str, robot_path: str) -> tuple[Any, Any]:
    import lss_motion as lss

    robot = lss.load_robot(robot_path)
    return lss.compile(lss.plan(lss.load_sequence(path, robot), robot), robot), robot


def play(path: str, robot_path: str) -> None:
    """Play here, with the options of `lss.play`."""
    import lss_motion as lss

    program, robot = _program(path, robot_path)
    for options in ({}, {"seed": 4}, {"has_feedback": False}):
        _report(lss.play(program, robot, is_virtual=True, **options))


def start(path: str, robot_path: str) -> None:
    """Play in a process of its own, from the start and from the middle."""
    import lss_motion as lss

    program, robot = _program(path, robot_path)
    for options in ({}, {"start_s": 0.8, "seed": 2}, {"has_feedback": False}):
        with lss.start(program, robot, is_virtual=True, **options) as show:
            _report(show.wait(60.0))
            kinds = [type(event).__name__ for event in show.events()]
            print(f"{len(kinds)} events, the last is {kinds[-1]}; {show!r}")
        _each(lambda one=show: one.rate(2.0), lambda one=show: one.seek("nowhere"))


def _report(report: Any) -> None:  # noqa: ANN401  (a report of the package)
    print(json.dumps(report.to_dict(), indent=1))


def wrong(path: str, robot_path: str) -> None:
    """Use the public functions as they must not be used."""
    import lss_motion as lss

    program, robot = _program(path, robot_path)
    loaded = lss.load_sequence(path, robot)
    pose: dict[str, Any] = {"sequence": "a", "keyframes": [{"at_s": 0.0, "deg": {"bse": 1.0}}]}
    _each(
        lambda: lss.load_robot("not_there.yaml"),
        lambda: lss.load_sequence(pose, robot),
        lambda: lss.load_sequence({"sequence": "a"}, robot),
        lambda: lss.play(program, robot, port="", is_virtual=True),
        lambda: lss.play(program, robot, port="/dev/nothing"),
        lambda: lss.play(program, robot, port="/dev/nothing", is_virtual=True),
        lambda: lss.connect(robot, port="/dev/nothing"),
        lambda: lss.play(program, program, is_virtual=True),
        lambda: lss.plan(loaded, lss.load_robot("mixed.yaml")),
        lambda: lss.start(program, robot, port="/dev/nothing").wait(30.0),
    )


def evening(path: str, faults: str = "") -> None:
    """Play a stage with cues from outside."""
    _records(inside.play_stage(path, 64.0, list(EVENING), faults))


def _records(records: Iterable[tuple[str, Any]]) -> None:
    for kind, value in records:
        print(kind, json.dumps(value, sort_keys=True))


def duet(left: str, right: str) -> None:
    """Play a show of two computers: pause, speed, seek, a figure that is lost and comes back."""

    def cut(world: Any, *, is_cut: bool) -> None:  # noqa: ANN401  (a model of a stage)
        world.hosts["f1"].is_cut = is_cut

    script = [
        (5.0, lambda world: world.conductor.pause(world.now_ns)),
        (8.0, lambda world: world.conductor.pause(world.now_ns, is_paused=False)),
        (11.0, lambda world: world.conductor.set_rate(0.5, world.now_ns)),
        (15.0, lambda world: world.conductor.set_rate(1.0, world.now_ns)),
        (16.0, lambda world: cut(world, is_cut=True)),
        (21.0, lambda world: cut(world, is_cut=False)),
        (26.0, lambda world: world.conductor.seek(3.0, world.now_ns)),
    ]
    parts = {"f0": left, "f1": right}
    for at_s, name, text in inside.play_computers(parts, script):
        print(f"{at_s:.6f} {name} {text}")
