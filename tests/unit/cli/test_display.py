from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from msgspec.structs import replace
from rich.console import Console

from lss_motion.cli.display import KEYS_HELP, Display, FrameHistory, frame_of, is_trouble, rendered
from lss_motion.planning import shows
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform

WAVE = Path(__file__).parents[3] / "sequences" / "wave.yaml"


@pytest.fixture(scope="module")
def frames():
    """Frames of a show at ten a second, from its first question to its end."""
    show = shows.prepare(WAVE, None, loop=1)
    found, memory = [], FrameHistory()

    def look(player, now_ns):
        if now_ns >= len(found) * 10**8:
            found.append(frame_of(player, now_ns, memory))

    observer = Observer(on_turn=look)
    perform(show.program, show.robot, is_virtual=True, observer=observer)
    return found


def drawn(frame, notes=(), width=100):
    out = io.StringIO()
    Console(file=out, width=width).print(rendered(frame, list(notes), KEYS_HELP, width))
    return out.getvalue()


def in_show(frames):
    return [frame for frame in frames if frame.phase == "playing"]


def test_a_frame_shows_how_far_the_show_is_and_the_keyframes_around(frames):
    late = in_show(frames)[40]
    text = drawn(late)
    assert f"{late.show_s:.1f} of {late.whole_s:.1f} s" in text
    times_s = [at_s for at_s, _ in late.marks]
    assert times_s[0] <= late.show_s < times_s[1]
    for at_s, label in late.marks:
        assert f"{label} {at_s:.1f} s" in text


def test_a_frame_shows_target_measured_and_error_of_every_joint(frames):
    frame = in_show(frames)[20]
    lines = drawn(frame).splitlines()
    assert len(frame.joints) == 5
    for name, target, measured, error, *_ in frame.joints:
        [line] = [line for line in lines if line.startswith(name)]
        assert line.split()[1:4] == [f"{target:.1f}", f"{measured:.1f}", f"{error:+.2f}"]


def test_a_frame_shows_what_the_line_does_now(frames):
    for frame in in_show(frames)[5:50]:
        share, answers_hz = frame.buses["main"]
        assert 0.01 < share < 0.3  # Five joints, 10 to 20 readings a second each, and targets.
        assert 40 <= answers_hz < 300
    assert "replies/s" in drawn(in_show(frames)[20])


def test_what_goes_wrong_stands_out_and_the_keys_are_seen_on_a_low_terminal(frames):
    frame = in_show(frames)[20]
    frame = replace(frame, joints=frame.joints * 6, missed=3, late_us=12_345)
    text = drawn(frame, ["warning: hot", "fault: joint 'a' is stuck"])
    top = "\n".join(text.splitlines()[:12])
    for words in ("3 missed", "late 12.3 ms", "warning: hot", "is stuck", KEYS_HELP):
        assert words in top


def test_before_the_show_there_is_a_frame_too(frames):
    assert frames[0].phase == "connecting"
    assert "connecting" in drawn(frames[0])


def test_what_goes_wrong_stays_on_the_screen_and_so_does_what_comes_last(capfd):
    show = shows.prepare(WAVE, None, loop=1)
    display, noted = Display(), []

    def look(player, now_ns):
        display.show(player, now_ns)
        if player.phase is Phase.SHOW and not noted:
            noted.append(now_ns)
            display.note("fault: joint 'a' is stuck")
            display.note("an ordinary line")

    observer = Observer(on_turn=look)
    perform(show.program, show.robot, is_virtual=True, observer=observer)
    # The keyboard's signals go to the session of the terminal.
    assert os.getsid(display._child.pid) == display._child.pid
    display.note("warning: the last word")
    display.close()
    lines = capfd.readouterr().err.splitlines()
    assert [line for line in lines if is_trouble(line)] == [
        "fault: joint 'a' is stuck",
        "warning: the last word",
    ]


def test_target_measured_and_error_are_of_one_instant(frames):
    rows = [row for frame in in_show(frames) for row in frame.joints if row[2] is not None]
    assert len(rows) > 100
    assert any(abs(target) > 20.0 for _, target, *_ in rows)
    for _, target, measured, error, *_ in rows:
        assert abs(target - measured - error) < 0.11


def test_a_pause_is_called_one_and_full_speed_too(frames):
    head = drawn(in_show(frames)[20]).splitlines()[0]
    assert "playing" in head
    assert "speed 100% (full)" in head
    show, found = shows.prepare(WAVE, None, loop=1), []

    def look(player, now_ns):
        if player.phase is Phase.SHOW and not found:
            player.set_rate(0.0, now_ns)
            found.append(frame_of(player, now_ns, FrameHistory()))
            player.set_rate(1.0, now_ns)

    observer = Observer(on_turn=look)
    perform(show.program, show.robot, is_virtual=True, observer=observer)
    head = drawn(found[0]).splitlines()[0]
    assert "paused" in head
    assert "playing" not in head
    assert "speed" not in head


def test_on_a_narrow_terminal_columns_are_left_out_and_none_is_cut(frames):
    frame = in_show(frames)[20]
    for width in (24, 40, 70, 100):
        text = drawn(frame, width=width)
        assert "…" not in text
        lines = text.splitlines()
        for name, _, _, error, *_ in frame.joints:
            [line] = [line for line in lines if line.split()[:1] == [name]]
            assert f"{error:+.2f}" in line.split()
        assert ("correction" in text) is (width >= 70)
