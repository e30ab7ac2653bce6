"""Every command and option that a message names exists; the advice of `check` works."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from lss_motion.planning.summaries import plan_lines
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Keyframe, Sequence, Timing
from lss_motion.units import SPEED_RATIO_MAX
from tests.joints import joint

ROOT = Path(__file__).resolve().parents[3]
HELP = ROOT / "tests" / "golden" / "help"
OF_OTHERS = {
    "--break-system-packages",
    "--user",
    "--with",
    "--now",
    "--man",
    "--no-video",
    "--really-quiet",
}
"""Options of pip, of this clone, of printers of pages and of players of sound."""
NAMED = re.compile(r"lss-(motion|play)((?: [^`\n]*)?)")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")


@cache
def options_of(command: str) -> frozenset[str]:
    return frozenset(OPTION.findall((HELP / f"{command}.txt").read_text("utf-8"))) | {"--help"}


COMMANDS = {path.stem for path in HELP.glob("*.txt")} - {"lss-motion"}
ALL = frozenset().union(*map(options_of, COMMANDS), {"--version"})


def texts_of(path: Path):
    """Yield the strings of a module that a person may read, with a mark where a value stands."""
    tree = ast.parse(path.read_text("utf-8"))
    inside = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            inside.update(id(part) for part in node.values)
            parts = [p.value if isinstance(p, ast.Constant) else "{}" for p in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and id(node) not in inside:
            yield node.lineno, str(node.value)


@pytest.mark.parametrize("package", ["cli", "planning", "playing", "maintenance", "show", "robot"])
def test_every_command_and_option_that_is_named_exists(package):
    wrong = []
    for path in sorted((ROOT / "lss_motion" / package).rglob("*.py")):
        for line, text in texts_of(path):
            for which, rest in NAMED.findall(text):
                words = rest.split()
                command = "lss-play" if which == "play" else (words or [""])[0].strip(".,;:)")
                if command not in COMMANDS:
                    continue
                until = re.split(r"\s{2,}|[`'\"]|\. |, |; | - ", rest.strip())[0]
                wrong += [
                    f"{path.name}:{line}: {command} has no {option}"
                    for option in OPTION.findall(until)
                    if option not in options_of(command)
                ]
            wrong += [
                f"{path.name}:{line}: no command has {option}"
                for option in OPTION.findall(text)
                if option not in ALL | OF_OTHERS
            ]
    assert not wrong


def show_of(**fields) -> tuple[Sequence, Robot]:
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    robot = Robot(name="arm", path=None, buses={"main": bus}, joints={"base": joint("base")})
    timed = fields.get("timing", Timing.AUTHORED) is not Timing.FASTEST
    deg = fields.pop("deg", 40.0)
    times = (0.0, fields.pop("over_s", 3.0)) if timed else (None, None)
    frames = [Keyframe(at_s=t, deg={"base": d}) for t, d in zip(times, (0.0, deg), strict=True)]
    return Sequence(name="slow", keyframes=tuple(frames), **fields), robot


@pytest.mark.parametrize("over_s", [3.0, 30.0, 300.0, 3000.0])
def test_the_speed_that_check_advises_is_one_that_can_be_given(over_s):
    show, robot = show_of(over_s=over_s, deg=0.4)
    (line,) = [line for line in plan_lines(plan(show, robot), robot) if "--speed" in line]
    ratio = float(re.findall(r"--speed ([0-9.]+)", line)[0])
    assert ratio <= SPEED_RATIO_MAX
    again, _ = show_of(over_s=over_s, deg=0.4, speed_ratio=ratio)
    assert plan(again, robot).duration_s == pytest.approx(over_s / ratio, rel=1e-6)


def test_no_speed_is_advised_where_none_above_1_can_be_given():
    show, robot = show_of(timing=Timing.FASTEST, smooth_s=0.3)
    assert not [line for line in plan_lines(plan(show, robot), robot) if "--speed" in line]
