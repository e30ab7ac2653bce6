"""sequence.yaml → `Sequence`: keyframes, events, functions of events, and refused files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.protocol.constants import Led
from lss_motion.robot.load import load_robot
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.show.load import function_problem, load_sequence
from lss_motion.show.model import Interpolation, Sequence, Timing

ROOT = Path(__file__).resolve().parents[3]


def times_s(sequence: Sequence) -> list[float | None]:
    return [keyframe.at_s for keyframe in sequence.keyframes]


def test_wave_reads_as_it_is_written() -> None:
    wave = load_sequence(ROOT / "sequences/wave.yaml")
    assert (wave.name, wave.timing, wave.loop) == ("wave", Timing.AUTHORED, 3)
    assert wave.robot_path == ROOT / "sequences/robots/desk_arm.yaml"
    assert wave.keyframes[0].deg["shoulder"] == 45.0
    assert wave.keyframes[0].label == "home"
    assert wave.keyframes[-1].at_s == 6.5
    assert wave.keyframes[-1].is_anchor


def test_after_s_counts_from_the_end_of_the_hold_before(load) -> None:
    sequence = load(
        "  - {after_s: 0.5, deg: {base: 1}, hold_s: 0.25}\n"
        "  - {after_s: 1, deg: {base: 2}}\n"
        "  - {at_s: 3, deg: {base: 3}}\n"
        "  - {after_s: 0.5, deg: {base: 4}}\n"
    )
    assert times_s(sequence) == [0.5, 1.75, 3.0, 3.5]


def test_keyframes_at_one_instant_move_together_and_end_with_the_longest_hold(load) -> None:
    sequence = load(
        "  - {at_s: 0, pose: home}\n"
        "  - {at_s: 1, deg: {base: 30}, hold_s: 0.5}\n"
        "  - {at_s: 1.0000000001, deg: {elbow: 10}, anchor: true}\n"
        "  - {after_s: 1, pose: home}"
    )
    assert [frame.at_s for frame in sequence.keyframes] == [0.0, 1.0, 1.0, 2.5]
    trajectory = plan(sequence, load_robot(sequence.robot_path))
    angles = dict(zip(trajectory.joints, trajectory.sample(np.array([1.0, 1.5])).T, strict=True))
    assert angles["base"].tolist() == pytest.approx([30.0, 30.0])
    assert angles["elbow"][0] == pytest.approx(10.0)
    assert angles["elbow"][1] < 9.0
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx([0.0, 1.0, 1.0, 2.5])


def test_the_first_keyframe_may_leave_its_time_out(load) -> None:
    assert times_s(load("  - {pose: home}\n  - {after_s: 2, pose: out}\n")) == [0.0, 2.0]


def test_without_any_time_the_timing_is_fastest(load) -> None:
    sequence = load("  - {pose: home}\n  - {pose: out, hold_s: 0.5}\n")
    assert sequence.timing is Timing.FASTEST
    assert times_s(sequence) == [None, None]
    assert sequence.keyframes[1].hold_s == 0.5


def test_one_keyframe_with_authored_timing_is_at_the_start(load) -> None:
    sequence = load("  - {pose: home}\ntiming: authored\n")
    assert (sequence.timing, times_s(sequence)) == (Timing.AUTHORED, [0.0])


def test_whether_a_hold_may_shrink_is_that_of_keyframe_track_or_file(load) -> None:
    frames = "  - {at_s: 0, deg: {%s: 0}, hold_s: 1}\n"
    other = "  - {after_s: 1, deg: {%s: 1}, hold_s: 1, hold_may_shrink: %s}\n"
    tracks = "tracks:\n  nod:\n    keyframes:\n    " + (frames % "elbow")

    def shrinking(text: str) -> list[bool]:
        sequence = load(text)
        frames = [f for part in (sequence, *sequence.tracks) for f in part.keyframes]
        return [keyframe.hold_may_shrink for keyframe in frames]

    base = frames % "base" + other % ("base", "true")
    assert shrinking(base + tracks) == [False, True, False]
    assert shrinking(base + "hold_may_shrink: true\n" + tracks) == [True, True, True]
    kept = "    hold_may_shrink: false\n"
    assert shrinking(base + "hold_may_shrink: true\n" + tracks + kept) == [True, True, False]


@pytest.mark.parametrize(
    ("keyframes", "times"),
    [
        ("  - {pose: home}\n  - {pose: out}\n", [None, None]),
        ("  - {pose: home}\n  - {at_s: 2, pose: out}\n", [0.0, 2.0]),
    ],
)
def test_fit_takes_keyframes_with_and_without_times(load, keyframes: str, times: list) -> None:
    sequence = load(keyframes + "timing: fit\nduration_s: 7.5\n")
    assert (sequence.timing, sequence.fit_duration_s) == (Timing.FIT, 7.5)
    assert times_s(sequence) == times


def test_angles_of_a_keyframe_win_over_its_pose(load) -> None:
    sequence = load("  - {pose: home, deg: {elbow: 5}}\n")
    assert sequence.keyframes[0].deg == {"base": 0.0, "elbow": 5.0}


def test_a_keyframe_keys_only_the_joints_it_names(load) -> None:
    sequence = load("  - {at_s: 0, pose: home}\n  - {at_s: 1, deg: {base: 3}}\n")
    assert sequence.keyframes[1].deg == {"base": 3.0}


def test_a_label_wins_over_the_name_of_the_pose(load) -> None:
    sequence = load(
        "  - {at_s: 0, pose: home}\n  - {at_s: 1, pose: out, label: reach}\n"
        "  - {at_s: 2, deg: {base: 1}}\n"
    )
    assert [keyframe.label for keyframe in sequence.keyframes] == ["home", "reach", ""]


def test_ease_of_a_keyframe_wins_over_interpolation_of_the_file(load) -> None:
    sequence = load(
        "  - {at_s: 0, pose: home}\n  - {at_s: 1, pose: out, ease: hold}\ninterpolation: spline\n"
    )
    eases = [keyframe.ease for keyframe in sequence.keyframes]
    assert eases == [Interpolation.SPLINE, Interpolation.HOLD]


@pytest.mark.parametrize(("written", "loop"), [("5", 5), ("forever", None), ("1", 1)])
def test_a_loop_is_a_count_or_forever(load, written: str, loop: int | None) -> None:
    text = "  - {at_s: 0, pose: home}\n  - {at_s: 1, pose: out}\n  - {at_s: 2, pose: home}\n"
    assert load(f"{text}loop: {written}\n").loop == loop


def test_keyframes_have_their_lines(load) -> None:
    sequence = load("  - {at_s: 0, pose: home}\n\n  - at_s: 1\n    pose: out\n")
    assert [keyframe.line for keyframe in sequence.keyframes] == [4, 6]


def test_a_time_at_the_end_of_a_hold_is_exactly_that_end(load) -> None:
    sequence = load(
        "  - {at_s: 0.1, deg: {base: 0}, hold_s: 0.2}\n  - {at_s: 0.3, deg: {elbow: 9}}\n"
    )
    first, second = sequence.keyframes
    assert second.at_s == first.at_s + first.hold_s


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("  - {at_s: 0, pose: hom}", 4, "unknown pose 'hom'; did you mean 'home'?"),
        ("  - {at_s: 0, deg: {elbw: 1}}", 4, "unknown joint 'elbw'; did you mean 'elbow'?"),
        (
            "  - {at_s: 0, pose: home}\n  - at_s: 1\n    deg:\n      base: 1\n      elbow: 90.5",
            8,
            "joint 'elbow' at 90.5 deg is outside its range, -90 to 90 deg",
        ),
        ("  - {at_s: 0, deg: {base: .nan}}", 4, "must be a finite number"),
        ("  - {at_s: .inf, deg: {base: 1}}", 4, "must be a finite number"),
        ("  - {at_s: '0', deg: {base: 1}}", 4, "keyframes.at_s ('0'): must be a number"),
        ("  - {at_s: true, deg: {base: 1}}", 4, "keyframes.at_s (true): must be a number"),
        ("  - {at_s: -1, deg: {base: 1}}", 4, "must be 0 or more"),
        ("  - {at_s: 1e5, deg: {base: 1}}", 4, "must be 86400 or less"),
        ("  - {at_s: 0, deg: {base: 1}, hold_s: -1}", 4, "must be 0 or more"),
        ("  - {at_s: 0, deg: {base: 1}, anchor: 1}", 4, "must be true or false"),
        ("  - {at_s: 0, deg: {base: 1}, ease: smoth}", 4, "did you mean 'smooth'?"),
        ("  - {at_s: 0, deg: {base: 1}, label: 3}", 4, "must be text"),
        ("  - {at_s: 0, deg: {base: 1}, label: ''}", 4, "must not be empty"),
        ('  - {at_s: 0, deg: {base: 1}, label: "a\\nb"}', 4, "U+000A"),
        ("  - {at_s: 0, deg: {base: 1}, anchr: true}", 4, "did you mean 'anchor'?"),
        ("  - {at_s: 0}", 4, "a keyframe names joints: give 'pose' or 'deg'"),
        ("  - {at_s: 0, deg: {}}", 4, "a keyframe names joints"),
        ("  - {at_s: 0, after_s: 0, deg: {base: 1}}", 4, "exclude each other"),
        ("  - home", 4, "must hold keys and values"),
        ("  - {at_s: 1, pose: home}\n  - {at_s: 0.5, pose: out}", 5, "times must increase"),
        (
            "  - {at_s: 1, pose: home}\n  - {at_s: 1, deg: {elbow: 3}}",
            5,
            "joint 'elbow' is at 3 deg here and at -20 deg in line 4, both at 1 s; keep one",
        ),
        (
            "  - {at_s: 1, deg: {base: 0}}\n  - {at_s: 1, pose: home}\n"
            "  - {after_s: 0, deg: {elbow: 3}}",
            6,
            "joint 'elbow' is at 3 deg here and at -20 deg in line 5, both at 1 s; keep one",
        ),
        (
            "  - {at_s: 0, deg: {elbow: 1}, hold_s: 1}\n  - {at_s: 0, deg: {base: 1}}\n"
            "  - {at_s: 1, deg: {elbow: 45}}",
            6,
            "joint 'elbow' would have to go from 1 to 45 deg in no time",
        ),
        (
            "  - {at_s: 86400, pose: home}\n  - {after_s: 1, pose: home}",
            5,
            "after_s: comes to 86401 s, more than a day",
        ),
        ("  - {at_s: 1, pose: home}\n  - {pose: out}", 5, "needs 'at_s' or 'after_s'"),
        (
            "  - {at_s: 0, pose: home, hold_s: 2}\n  - {at_s: 1, pose: out}",
            5,
            "1 s is before the end of the keyframe before, which is held until 2 s",
        ),
        (
            "  - {at_s: 0, pose: home, hold_s: 1}\n  - {at_s: 1, pose: out}",
            5,
            "joint 'elbow' would have to go from -20 to 45 deg in no time",
        ),
        ("  - {pose: home}\n  - {pose: out}\ntiming: authored", 6, "no keyframe has 'at_s'"),
        ("  - {at_s: 0, pose: home}\ntiming: fastest", 4, "at_s: timing: fastest finds the times"),
        ("  - {at_s: 0, pose: home}\ntiming: fit", 5, "needs 'duration_s'"),
        ("  - {at_s: 0, pose: home}\nduration_s: 3", 5, "belongs to timing: fit"),
        ("  - {pose: home}\ntiming: fit\nduration_s: 0", 6, "must be 0.001 or more"),
        ("  - {pose: home, anchor: true}", 4, "an anchor keeps an authored time"),
        (
            "  - {at_s: 1, pose: home, anchor: true}\ntiming: fit\nduration_s: 3",
            4,
            "an anchor keeps an authored time",
        ),
        ("  - {at_s: 0, pose: home}\ntiming: quick", 5, "there are: authored, fastest, fit"),
        ("  - {at_s: 0, pose: home}\ninterpolation: cubic", 5, "there are: smooth, spline"),
        ("  - {at_s: 0, pose: home}\nloop: 0", 5, "a count from 1 to 1,000,000, or forever"),
        ("  - {at_s: 0, pose: home}\nloop: true", 5, "a count from 1 to 1,000,000, or forever"),
        ("  - {at_s: 0, pose: home}\nloop: 2.0", 5, "a count from 1 to 1,000,000, or forever"),
        (
            "  - {at_s: 0, pose: home}\n  - {at_s: 1, pose: out}\nloop: 2",
            5,
            "a loop must end where it began, but elbow starts at -20 and ends at 45 deg",
        ),
        ("  - {at_s: 0, pose: home}\nloop: forever", 4, "a loop must take time"),
        ("  - {at_s: 0, pose: home}\ntracks: {}", 5, "tracks (keys and values): must have 1"),
        ("  - {at_s: 0, pose: home}\nlayers: []", 5, "layers ([]): must have 1 or more"),
        ("  - {at_s: 0, pose: home}\nspeed_ratio: 0", 5, "must be 0.01 or more"),
        ("  - {pose: home}\nspeed_ratio: 1.5", None, "fast as the limits allow; 1 is the most"),
        ("  - {at_s: 0, pose: home}\nplay: [{pause_s: 1}]", 3, "keyframes does not go with 'play'"),
        ("  - nod", 4, "keyframes item 1 ('nod'): must hold keys and values, such as {"),
        ("  - {at_s: 0, pose: home}\nplay: [nod.yaml]", 5, "values, such as {file: …}"),
        ("  - {at_s: 0, deg: {base: 0}}\ntracks: {eyes: {loop: 2}}", 5, "'eyes' has no keyframes"),
        (
            "  - {at_s: 0, deg: {base: 0}}\ntracks:\n  eyes: {keyframes: [{deg: {base: 1}}]}",
            6,
            "joint 'base' is keyed in track 'eyes' and in the keyframes outside tracks",
        ),
        ("  []", 3, "must have 1 or more entries"),
        ("  - {at_s: 0, pose: home}\nloop_span_s: [2, 1]", 5, "would end at 1 s, not after 2 s"),
        ("  - {pose: home}\nloop_span_s: [1, 2]", 5, "needs timing: authored"),
        (
            "  - {at_s: 0, deg: {base: 0}}\nloop_span_s: [1, 2]\nevents: [{at_s: 1, say: hi}]",
            5,
            "only keyframes without tracks and events can be looped in part",
        ),
        ("  - {at_s: 0, pose: home}\nkeyframes: []", 5, "is given twice"),
    ],
)
def test_a_wrong_entry_is_refused_with_line_and_reason(
    refusals, text: str, line: int, reason: str
) -> None:
    found = refusals(text + "\n")
    assert found[0][0] == line
    assert reason in found[0][1]
    assert len(found) == 1 or "given twice" in reason


def test_a_part_can_be_looped_in_keyframes_that_do_not_close(load) -> None:
    sequence = load(
        "  - {at_s: 0, deg: {base: 0}}\n  - {at_s: 5, deg: {base: 9}}\n"
        "loop: 7\nloop_span_s: [1.5, 2.25]\n"
    )
    assert (sequence.loop, sequence.loop_span_s) == (7, (1.5, 2.25))


def test_all_problems_of_a_file_come_in_one_run(refusals) -> None:
    found = refusals(
        "  - {at_s: 0, pose: hom}\n"
        "  - {at_s: x, pose: home}\n"
        "  - {at_s: 2, deg: {base: 91}}\n"
        "  - {at_s: 1, deg: {base: 1}}\n"
        "  - {after_s: 1, deg: {bas: 1}}\n"
        "loop: never\n"
        "layers: []\n"
    )
    assert [line for line, _ in found] == [4, 5, 6, 7, 8, 9, 10]


def test_an_unreadable_time_does_not_make_later_times_wrong(refusals) -> None:
    found = refusals(
        "  - {at_s: 5, pose: home}\n  - {at_s: x, pose: home}\n"
        "  - {after_s: 1, pose: out}\n  - {at_s: 3, pose: home}\n"
    )
    assert [line for line, _ in found] == [5]


def test_a_loop_with_an_unreadable_end_is_reported_once(refusals) -> None:
    found = refusals(
        "  - {at_s: 0, pose: home}\n  - {at_s: 1, pose: out}\n  - {at_s: x, pose: home}\nloop: 3\n"
    )
    assert [line for line, _ in found] == [6]


def test_more_keyframes_than_the_bound_are_refused(refusals) -> None:
    text = "".join(f"  - {{at_s: {n}, deg: {{base: 0}}}}\n" for n in range(10_001))
    ((line, reason),) = refusals(text)
    assert line == 3
    assert "must have 10000 or fewer entries" in reason


def test_a_missing_robot_file_is_named_with_its_path(folder: Path) -> None:
    path = folder / "test.yaml"
    path.write_text("sequence: s\nrobot: robts.yaml\nkeyframes: [{at_s: 0, pose: home}]\n")
    with pytest.raises(InputError, match=r"robot file 'robts\.yaml' not found") as caught:
        load_sequence(path)
    assert caught.value.line == 2
    assert str(folder / "robts.yaml") in caught.value.reason


def test_a_sequence_without_a_robot_is_refused_unless_one_is_given(folder: Path) -> None:
    path = folder / "test.yaml"
    path.write_text("sequence: s\nkeyframes: [{at_s: 0, pose: home}]\n")
    with pytest.raises(InputError, match="no robot: give 'robot: FILE' here, or --robot FILE"):
        load_sequence(path)
    robot = load_robot(folder / "robot.yaml")
    assert load_sequence(path, robot).keyframes[0].deg == {"base": 0.0, "elbow": -20.0}


def test_a_given_robot_wins_over_the_named_one(folder: Path, load) -> None:
    other = folder / "other.yaml"
    text = (folder / "robot.yaml").read_text(encoding="utf-8")
    other.write_text(text.replace("elbow: -20", "elbow: 33"), encoding="utf-8")
    load("  - {at_s: 0, pose: home}\n")
    sequence = load_sequence(folder / "test.yaml", load_robot(other))
    assert sequence.keyframes[0].deg["elbow"] == 33.0
    assert sequence.robot_path == other


def test_problems_of_the_robot_file_come_with_those_of_the_sequence(folder: Path, refusals) -> None:
    robot = (folder / "robot.yaml").read_text(encoding="utf-8")
    (folder / "robot.yaml").write_text(robot.replace("{id: 2}", "{id: 1}"), encoding="utf-8")
    found = refusals("  - {at_s: 0, pose: hom, anchr: 1}\n")
    assert [line for line, _ in found] == [4, 5]
    assert "both have id 1" in found[1][1]


def test_the_escalations_of_a_show_are_read(load) -> None:
    sequence = load("  - {pose: home}\non_fault: {astray: warn, silent: [resume, limp]}\n")
    assert sequence.on_fault == {
        Cause.ASTRAY: (FaultStep.WARN,),
        Cause.SILENT: (FaultStep.RESUME, FaultStep.LIMP),
    }
    assert plan(sequence, load_robot(sequence.robot_path)).on_fault == sequence.on_fault


def test_a_wrong_step_of_an_escalation_is_refused_with_its_line(load) -> None:
    with pytest.raises(InputError, match=r":\d+: on_fault.astray \('slw'\): .*did you mean 'slow'"):
        load("  - {pose: home}\non_fault: {astray: slw}\n")


KEYS = "  - {at_s: 0, pose: home}\n  - {at_s: 2, pose: out}\n"


def test_events_are_read(load, folder):
    (folder / "bell.wav").touch()
    (folder / "effects").mkdir()
    (folder / "effects" / "smoke.py").write_text("def fog(at_s): pass\n")
    show = load(
        KEYS
        + "events:\n"
        + "  - {at_s: 1, led: {base: red, elbow: white}}\n"
        + "  - {at_s: 1.5, say: hello}\n"
        + "  - {at_s: 1.5, run: 'effects.smoke:fog'}\n"
        + "  - {at_s: 2, sound: bell.wav, lead_s: 0.25}\n"
    )
    led, say, run, sound = show.events
    assert (led.at_s, led.led) == (1.0, (("base", Led.RED), ("elbow", Led.WHITE)))
    assert (say.at_s, say.say) == (1.5, "hello")
    assert (run.run, run.folder) == ("effects.smoke:fog", str(folder))
    assert (sound.sound, sound.start_s) == (str(folder / "bell.wav"), 1.75)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{at_s: 1}", "one of led, say, run, sound, not none"),
        ("{at_s: 1, say: a, run: 'b:c'}", "not say and run"),
        ("{at_s: 1, led: {bose: red}}", "unknown joint 'bose'"),
        ("{at_s: 1, led: {base: pink}}", "'pink'"),
        ("{at_s: 1, run: fog}", "'fog'"),
        ("{at_s: 1, run: 'nomodule:fog'}", "there is no module 'nomodule' in "),
        ("{at_s: 1, run: 'json.none:fog'}", "there is no module 'json.none' in "),
        ("{at_s: 1, run: 'json:lods'}", "did you mean 'loads'?"),
        ("{at_s: 1, sound: none.wav}", "sound file 'none.wav' not found"),
        ("{at_s: 1, say: a, lead_s: 1}", "lead_s belongs to a sound"),
        ("{say: a}", "at_s"),
    ],
)
def test_a_wrong_event_is_refused_with_its_line(refusals, entry, words):
    [(line, reason)] = refusals(KEYS + "events:\n  - " + entry + "\n")
    assert line == 7
    assert words in reason


@pytest.fixture
def problem(tmp_path):
    """Return the problem of `run` if `effects/lights.py` holds `text`."""

    def make(text, run="effects.lights:fog"):
        (tmp_path / "effects").mkdir(exist_ok=True)
        (tmp_path / "effects" / "__init__.py").write_text("raise SystemExit('was run')\n")
        (tmp_path / "effects" / "lights.py").write_text("import lss_motion.none\n" + text)
        return function_problem(run, str(tmp_path))

    return make


@pytest.mark.parametrize(
    "text",
    [
        "def fog(at_s): pass",
        "async def fog(at_s): pass",
        "if True:\n    fog = print",
        "from mist import fog",
        "from mist import steam as fog",
        "import fog",
        "class fog: pass",
        "from mist import *",
        "def __getattr__(name): return print",
        "globals()['fog'] = print",
    ],
)
def test_a_function_is_found_without_running_its_module(problem, text):
    before = set(sys.modules)
    assert problem(text) == ""
    assert not {name for name in set(sys.modules) - before if "effects" in name}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def fogg(at_s): pass", "lights.py has no function 'fog'; did you mean 'fogg'?"),
        ("print(fog)", "lights.py has no function 'fog'; there are none"),
        ("from fog import mist", "has no function 'fog'"),
        ("def fog(at_s) pass", "lights.py:2 is no Python: "),
        ("\0", "lights.py"),
    ],
)
def test_a_function_that_a_module_lacks_is_reported(problem, text, words):
    assert words in problem(text)


@pytest.mark.parametrize("run", ["effects.none:fog", "none:fog", "effects.lights.fog:fog"])
def test_a_missing_module_is_named(problem, tmp_path, run):
    module = run.partition(":")[0]
    reason = problem("", run)
    assert reason == f"there is no module {module!r} in {tmp_path}, nor is one installed"


@pytest.mark.parametrize(
    "run", ["time:sleep", "math:sqrt", "json:dumps", "lss_motion.units:s_from_ns"]
)
def test_functions_of_installed_modules_are_found(problem, run):
    assert problem("", run) == ""


def test_a_robot_file_in_place_of_a_sequence_is_one_message() -> None:
    with pytest.raises(InputError) as caught:
        load_sequence(ROOT / "sequences/robots/desk_arm.yaml")
    assert "this is a robot file" in str(caught.value)
    assert not caught.value.more
