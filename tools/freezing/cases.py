"""Which commands are frozen. A case is a list of steps which one process runs in its own folder.

Left out is what needs another process in real time: sim, studio, serve with its page, the network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from freezing.capture import Step
from freezing.inputs import FAULTS, FOREIGN, MAPS, MISTAKES, ROBOTS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

QUICK_FAULTS: Final = {
    "timed": ("corrupt_command", "reset", "unplugged"),
    "streamed": ("oversleep",),
    "ladders": ("stuck",),
    "mixed": ("many",),
}
"""Fault plans of the quick set, by robot; the whole set has every plan on `FAULT_ROBOTS`."""
FAULT_ROBOTS: Final = ("timed", "streamed", "ladders", "mixed", "pro")
QUICK_PLAYS: Final = ("nod",)
"""Examples that the quick set plays; their shows are short."""
LONG_S: Final = {"hexapod_show": 42, "hexapod_dance": 22, "hexapod_walk": 20, "show": 15}
"""Examples that take long to play, and about how long; they begin first."""


@dataclass(frozen=True, slots=True)
class Case:
    """Steps that follow each other in one folder; `weight_s` is about how long they take."""

    name: str
    steps: tuple[Step, ...]
    weight_s: float = 3.0


def cases(sequences: Path, *, is_quick: bool) -> list[Case]:
    """Return all cases, the longest first; the quick set is a part of the whole."""
    found = [*_examples(sequences), *_families(), *_faults(), *_others()]
    if is_quick:
        found = [
            Case(case.name, tuple(step for step in case.steps if step.is_quick), case.weight_s)
            for case in found
        ]
    return sorted((case for case in found if case.steps), key=lambda case: -case.weight_s)


def _examples(sequences: Path) -> Iterator[Case]:
    for path in sorted([*sequences.glob("*.yaml"), *(sequences / "parts").glob("*.yaml")]):
        file = path.relative_to(sequences.parent).as_posix()
        name, steps = path.stem, list(_planned(file))
        if path.read_text(encoding="utf-8").find("\ngait:") >= 0:
            words = ("lss-motion", "gait", file, "-o", "gait.yaml")
            steps.append(Step("gait", words, ("gait.yaml",), is_quick=True))
        is_quick = name in QUICK_PLAYS
        steps.append(_play("play1", file, seed=1, is_quick=is_quick))
        if name not in LONG_S:
            half = _play("half", file, "--speed", "0.5", "--no-feedback", seed=2)
            steps += [_play("play7", file, seed=7), half]
        is_quick = path.parent == sequences and name not in ("hexapod_show", "hexapod_dance")
        steps.append(_play("blind", file, "--no-feedback", is_quick=is_quick))
        yield Case(f"example.{name}", tuple(steps), LONG_S.get(name, 12))


def _planned(file: str) -> Iterator[Step]:
    """Yield everything before a robot is involved."""
    yield Step("check", ("lss-motion", "check", file), is_quick=True)
    words = ("lss-motion", "compile", file, "-o", "program.lss")
    yield Step("compile", words, ("program.lss",), is_quick=True)
    words = ("lss-motion", "plan", file, "--csv", "plan.csv", "--rate-hz", "20")
    yield Step("plan", words, ("plan.csv",), is_quick=True)


def _play(name: str, file: str, *options: str, seed: int = 0, is_quick: bool = False) -> Step:
    """Return a play in virtual time that keeps the bytes, the horns and the report."""
    files = ("bytes.log", "horns.csv", "report.json")
    kept = ("--log", files[0], "--truth", files[1], "--report", files[2])
    words = ("lss-play", file, "--virtual", "--seed", str(seed), *kept, *options)
    return Step(name, words, files, is_quick=is_quick)


def _families() -> Iterator[Case]:
    for robot in ROBOTS:
        file = f"{robot}_show.yaml"
        ids = ("1", "2") if robot == "mixed" else ("1", "5")
        steps = [
            *_planned(file),
            _play("play1", file, seed=1, is_quick=True),
            *(
                Step(f"replay{servo}", ("lss-motion", "replay", "bytes.log", "--servo", servo))
                for servo in ids
            ),
            Step("replay", ("lss-motion", "replay", "bytes.log"), is_quick=True),
            Step("again", ("lss-motion", "replay", "bytes.log", "--again"), is_quick=True),
            Step("report", ("lss-motion", "report", "report.json"), is_quick=True),
            _play("play2", file, seed=2),
            _play("blind", file, "--no-feedback", is_quick=True),
            _play("program", "program.lss", seed=3, is_quick=robot == "timed"),
            _play("half", file, "--speed", "0.5", seed=4),
            _play("loop", file, "--loop", "2", seed=6),
            _play("from", file, "--from", "0.8", seed=5, is_quick=robot == "timed"),
        ]
        yield Case(f"family.{robot}", tuple(steps), 15)
    steps = [
        Step("check", ("lss-motion", "check", "waits.yaml"), is_quick=True),
        _play("input", "waits.yaml", "--faults", "faults_input.yaml", seed=1, is_quick=True),
        _play("timeout", "waits.yaml", seed=1),
    ]
    yield Case("family.waits", tuple(steps), 8)


def _faults() -> Iterator[Case]:
    for robot in FAULT_ROBOTS:
        for faults in FAULTS:
            options = ("--faults", f"faults_{faults}.yaml")
            is_quick = faults in QUICK_FAULTS.get(robot, ())
            steps = [_play("play1", f"{robot}_show.yaml", *options, seed=1, is_quick=is_quick)]
            if robot in ("timed", "mixed"):
                steps.append(_play("play2", f"{robot}_show.yaml", *options, seed=2))
            if faults in ("lost_command", "reset", "unplugged", "oversleep"):
                steps.append(_play("blind", f"{robot}_show.yaml", "--no-feedback", *options))
            yield Case(f"faults.{robot}.{faults}", tuple(steps), 4)


def _others() -> Iterator[Case]:
    yield Case("refused", tuple(_refused()), 2)
    yield Case("import", tuple(_imports()), 6)
    yield Case("export", tuple(_exports()), 4)
    yield Case("maintenance", tuple(_maintenance()), 10)
    yield Case("identify", tuple(_identify()), 15)
    yield Case("record", tuple(_record()), 8)
    yield Case("pages", tuple(_pages()), 2)
    for kind in MISTAKES:
        yield Case(f"mistakes.{kind}", tuple(_mistakes(kind)), 4)
    yield Case("mistakes.option", tuple(_wrong_options()), 3)
    for name, steps in (("hands", _hands()), ("keys", _keys()), ("python", _python())):
        yield Case(name, tuple(steps), 6)
    for name in ("hexapod_walk", "quadruped_trot"):
        yield Case(f"walk.{name}", (_walk(name),), 10)
    yield Case("stage", tuple(_stage()), 6)


def _refused() -> Iterator[Step]:
    """Yield files and options with mistakes, and shows that are slowed or cannot be planned."""
    for file in ("wrong", "too_fast", "too_fast_anchor", "not_there"):
        yield Step(file, ("lss-motion", "check", f"{file}.yaml"), is_quick=True)
    yield Step("dry", ("lss-play", "timed_show.yaml", "--dry-run"), is_quick=True)
    yield Step("option", ("lss-play", "timed_show.yaml", "--speeed", "2"), is_quick=True)
    words = ("lss-play", "timed_show.yaml", "--virtual", "--faults", "wrong.yaml")
    yield Step("faults", words, is_quick=True)


def _imports() -> Iterator[Step]:
    for file in FOREIGN:
        name, words = (
            file.replace(".", "_"),
            ("lss-motion", "import", file, "--robot", "timed.yaml"),
        )
        mapped, made = f"{name}_map.yaml", f"{name}_imported.yaml"
        yield Step(f"{name}.map", (*words, "--make-map", mapped), (mapped,), is_quick=True)
        yield Step(name, (*words, "-o", made), (made,), is_quick=True)
        used = f"{name}_joints.yaml" if file in MAPS else mapped
        words = (*words, "--map", used, "-o", f"mapped_{made}", "--tolerance-deg", "0.5")
        yield Step(f"{name}.mapped", words, (f"mapped_{made}",), is_quick=file in MAPS)
    yield from _planned("recorded_csv_imported.yaml")


def _exports() -> Iterator[Step]:
    for kind, file in (
        ("csv", "out.csv"), ("ros", "out.yaml"), ("blender-csv", "frames.csv"),
        ("blender-json", "out.json"), ("lss", "out.lss"),
    ):  # fmt: skip
        words = ("lss-motion", "export", "timed_show.yaml", "--to", kind, "--rate-hz", "25")
        yield Step(kind, (*words, "-o", file), (file,), is_quick=True)


def _maintenance() -> Iterator[Step]:
    def step(name: str, *words: str, files: tuple[str, ...] = (), is_quick: bool = True) -> Step:
        return Step(name, ("lss-motion", *words), files, is_quick=is_quick, is_real_time=True)

    yield step("scan", "scan", "--robot", "mixed.yaml", is_quick=False)
    yield step(
        "starter", "scan", "--robot", "timed.yaml", "--baud", "115200", "-o", "starter.yaml",
        files=("starter.yaml",),
    )  # fmt: skip
    yield step("shown", "configure", "timed.yaml")
    yield step("differences", "configure", "stored.yaml", "--dry-run")
    yield step("written", "configure", "stored.yaml", "--yes")
    yield step("session", "configure", "stored.yaml", "--session", "--yes", is_quick=False)
    yield step("set", "configure", "mixed.yaml", "--set", "LED=3", "--joint", "pan", "--yes")
    yield step("baud", "configure", "timed.yaml", "--new-baud", "500000", "--yes")
    yield step("id", "configure", "timed.yaml", "--id", "5", "--new-id", "7", "--yes")
    yield step("backup", "configure", "mixed.yaml", "--backup", "b.yaml", files=("b.yaml",))
    yield step("restore", "configure", "mixed.yaml", "--restore", "b.yaml", "--yes")
    yield step(
        "monitor", "monitor", "mixed.yaml", "--for", "2", "--csv", "monitor.csv", "--quiet",
        files=("monitor.csv",),
    )  # fmt: skip
    yield step("query", "send", "--robot", "timed.yaml", "--id", "5", "QV")
    yield step("move", "send", "--robot", "timed.yaml", "--id", "5", "D", "20", "T", "500")
    yield step("silent", "send", "--robot", "timed.yaml", "--id", "77", "QD")


def _identify() -> Iterator[Step]:
    words = ("lss-motion", "identify", "--virtual", "--yes", "--seed", "3")
    for robot, joint, made in (
        ("timed", "elbow", "measured.yaml"),
        ("streamed", "base", "streamed_measured.yaml"),
        ("pro", "base", "pro_measured.yaml"),
    ):
        arguments = (*words, "--robot", f"{robot}.yaml", joint, "-o", made)
        yield Step(robot, arguments, (made,), is_quick=robot == "timed")


def _record() -> Iterator[Step]:
    words = ("lss-motion", "record", "--virtual", "--force", "-o", "shown.yaml", "--seconds", "3")
    for robot, feel in (("timed", "limp"), ("old", "soft")):
        arguments = (*words, "--robot", f"{robot}.yaml", "--hand", "3", "--feel", feel)
        yield Step(robot, arguments, ("shown.yaml",), is_quick=feel == "limp")


def _pages() -> Iterator[Step]:
    for kind in ("robot", "sequence", "gait"):
        words = ("lss-motion", "schema", kind)
        yield Step(f"schema.{kind}", words, is_quick=True, has_numbers=False)
    yield Step("reference", ("lss-motion", "reference"), is_quick=True)
    for name in ("lss-play", "lss-motion"):
        yield Step(name, (name, "--help"), is_quick=True, has_numbers=False)


def _mistakes(kind: str) -> Iterator[Step]:
    """Yield a step a mistake: what the command says to it is compared to the word."""
    command, file, changes = MISTAKES[kind]
    words = {
        "check": ("lss-motion", "check", file),
        "gait": ("lss-motion", "gait", file),
        "faults": ("lss-play", "timed_show.yaml", "--virtual", "--faults", file),
    }[command]
    changed = "timed.yaml" if kind == "robot" else file
    for number, change in enumerate(changes, 1):
        name = f"{number:02d}"
        yield Step(name, words, is_quick=True, has_numbers=False, change=(changed, change))


def _wrong_options() -> Iterator[Step]:
    play, record = ("lss-play", "timed_show.yaml"), ("lss-motion", "record", "-o", "x.yaml")
    for number, words in enumerate(
        (
            ("lss-play",), (*play, "--speed", "0"), (*play, "--speed", "2", "--virtual"),
            (*play, "--from", "nowhere"), (*play, "--from", "99", "--virtual"),
            (*play, "--loop", "0"), (*play, "--port", "/dev/nothing"), (*play, "--port", ""),
            (*play, "--port", "/dev/nothing", "--yes"), (*play, "--robot", "not_there.yaml"),
            (*play, "--robot", "mixed.yaml"), (*play, "--virtual", "--report", "timed.yaml"),
            (*play, "--virtual", "--log", "no/where.log"), (*play, "--virtual", "--seed", "x"),
            (*play, "--faults", "faults_many.yaml", "--port", "/dev/nothing", "--yes"),
            ("lss-play", "timed.yaml"), ("lss-play", "."), ("lss-play", "hall.yaml"),
            ("lss-motion", "chekc"), ("lss-motion", "check"), ("lss-motion", "check", "bow.wav"),
            ("lss-motion", "plan", "timed_show.yaml", "--rate-hz", "0"),
            ("lss-motion", "compile", "timed_show.yaml", "-o", "timed_show.yaml"),
            ("lss-motion", "export", "timed_show.yaml", "--to", "mp3", "-o", "x"),
            ("lss-motion", "import", "timed.yaml", "-o", "x.yaml"),
            ("lss-motion", "replay", "timed.yaml"), ("lss-motion", "report", "timed.yaml"),
            ("lss-motion", "jog", "timed.yaml"), ("lss-motion", "calibrate", "timed_show.yaml"),
            ("lss-motion", "calibrate", "timed.yaml", "--at", "hoem"), record,
            (*record, "--robot", "timed.yaml", "--virtual"),
            (*record, "--robot", "timed.yaml", "--joints", "elbwo", "--seconds", "1"),
            ("lss-motion", "walk", "timed_show.yaml"),
            ("lss-motion", "walk", "trot.yaml", "--forward-mm-s", "900"),
            ("lss-motion", "configure", "timed.yaml", "--set", "ZZ=3", "--yes"),
            ("lss-motion", "configure", "timed.yaml", "--set", "LED=99", "--yes"),
            ("lss-motion", "send", "--robot", "timed.yaml", "--id", "5", "ZZ"),
            ("lss-motion", "identify", "--robot", "timed.yaml", "elbwo", "--virtual"),
            ("lss-motion", "scan", "--port", "/dev/nothing"),
            ("lss-motion", "serve", "timed.yaml"), ("lss-motion", "serve", "not_there.yaml"),
            ("lss-motion", "serve", "sequences/stages/duet.yaml"),
            ("lss-motion", "serve", "sequences/stages/duet.yaml", "--figure", "middle"),
            ("lss-motion", "serve", "hall.yaml", "--start-at", "25:00"),
            ("lss-motion", "monitor", "timed.yaml", "--for", "-1"),
            ("lss-motion", "schema", "none"), ("lss-motion", "example", "none"),
        ),
        1,
    ):  # fmt: skip
        yield Step(f"{number:02d}", words, is_quick=True, has_numbers=False)


LEFT: Final = "\x1b[D"
RIGHT: Final = "\x1b[C"
DOWN: Final = "\x1b[B"


def _pressed(every_s: float, *keys: str, from_s: float = 3.0) -> tuple[tuple[float, str], ...]:
    return tuple((from_s + every_s * index, key) for index, key in enumerate(keys))


def _hands() -> Iterator[Step]:
    """Yield what a person does with keys and hands: `jog`, `calibrate`, `record`."""

    def step(name: str, *words: str, keys: tuple[str, ...], file: str, every_s: float) -> Step:
        return Step(
            name, ("lss-motion", *words), (file,), is_quick=True, is_real_time=True,
            keys=_pressed(every_s, *keys), has_wire=True,
        )  # fmt: skip

    steered = (
        RIGHT, RIGHT, DOWN, LEFT, "]", "]", LEFT, "c", "\n", DOWN, "l", "h", "[", RIGHT, "c", "\n",
        DOWN, LEFT, LEFT, LEFT, "j", "k", "q",
    )  # fmt: skip
    for robot, *more in (
        ("timed",),
        ("mixed", "--joints", "pan", "wing", "auto", "slide", "turn"),
    ):
        words = ("jog", f"{robot}.yaml", *more)
        yield step(f"jog.{robot}", *words, keys=steered, file=f"{robot}.yaml", every_s=0.7)
    words = ("jog", "old.yaml", "--joints", "reach", "--pose", "home")
    keys = (RIGHT, LEFT, "c", "\x03")
    yield step("jog.ctrl_c", *words, keys=keys, file="old.yaml", every_s=0.6)
    led = ("--hand", "by_hand.csv")
    for name, robot, more, keys in (
        ("written", "timed", (), ("l", "\n", "\n", "\n", "s", "\n", "y")),
        ("servos", "streamed", ("--at", "home", "--to-servos"), ("l", "\n", *"ssss", "y")),
        ("refused", "old", (), ("l", "\n", *"ssss", "n")),
        ("ended", "pro", ("--joints", "base"), ("l", "\n", "q")),
    ):
        words = ("calibrate", f"{robot}.yaml", *led, *more)
        file = f"{robot}.yaml"
        yield step(f"calibrate.{name}", *words, keys=keys, file=file, every_s=2.0)
    for feel in ("limp", "soft"):
        words = ("record", "--robot", "timed.yaml", "-o", f"{feel}.yaml", *led, "--feel", feel)
        keys = ("l", "p", "r", "r", "p", "u", "l", "p", "q")
        yield step(f"record.{feel}", *words, keys=keys, file=f"{feel}.yaml", every_s=1.2)


def _keys() -> Iterator[Step]:
    """Yield shows in real time that a person steers with keys and Ctrl-C."""
    for robot in ("timed", "mixed"):
        for name, keys in {
            "paused": _pressed(0.5, " ", " ", "-", "-", "-", "+", "+", from_s=1.5),
            "stopped": ((2.0, "q"),),
            "ended": ((2.0, "\x03"),),
            "at_once": ((2.0, "\x03"), (2.05, "\x03")),
            "early": ((0.01, "q"),),
        }.items():
            words = ("lss-play", f"{robot}_show.yaml", "--report", "report.json")
            yield Step(
                f"{robot}.{name}", words, ("report.json",), is_quick=True, is_real_time=True,
                keys=keys, has_wire=True,
            )  # fmt: skip
    words = ("lss-play", "timed_show.yaml", "--careful")
    yield Step("careful", words, is_quick=True, is_real_time=True, has_wire=True)


def _walk(name: str) -> Step:
    """Return a walk that is steered with keys, slowed, let sit down and ended."""
    keys = _pressed(1.1, "w", "w", "d", LEFT, "-", "s", "+", " ", "x", "x", "w", "q", from_s=6.0)
    words = ("lss-motion", "walk", f"sequences/{name}.yaml", "--report", "report.json")
    is_quick = name == "quadruped_trot"
    return Step(
        "walk", words, ("report.json",), is_quick=is_quick, is_real_time=True, keys=keys,
        has_wire=True,
    )  # fmt: skip


def _python() -> Iterator[Step]:
    """Yield what is done from Python."""
    for robot, *joints in (("timed", "elbow", "base"), ("mixed", "turn", "pan")):
        words = ("script", "connect", f"{robot}.yaml", *joints)
        yield Step(f"connect.{robot}", words, is_quick=True, has_wire=True)
        for name in ("play", "start", "wrong"):
            words = ("script", name, f"{robot}_show.yaml", f"{robot}.yaml")
            yield Step(f"{name}.{robot}", words, is_quick=True, has_wire=True)


def _stage() -> Iterator[Step]:
    """Yield stages in virtual time: cues from outside, rests and faults, and two computers."""
    for name in ("", "visitor", "deaf"):
        faults = (f"hall_{name}.yaml",) if name else ()
        words = ("script", "evening", "hall.yaml", *faults)
        yield Step(f"evening{name and '.'}{name}", words, is_quick=name != "visitor", has_wire=True)
    yield Step("check", ("lss-motion", "check", "hall.yaml"), is_quick=True)
    parts = ("sequences/parts/duet_left.yaml", "sequences/parts/duet_right.yaml")
    yield Step("duet", ("script", "duet", *parts), is_quick=True, has_wire=True)
