"""What a sound device is given while a show plays, recorded from a device without hardware."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import lss_motion as lss
from benches import sound_recorder
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.sound_choice import SoundChoice
from tests.programs import ProgramBeside, command
from tests.swing import until

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.slow,
    pytest.mark.skipif(bool(sound_recorder.missing()), reason=sound_recorder.missing()),
]

ROBOT = Path(__file__).parents[2] / "sequences" / "robots" / "desk_arm.yaml"
RATE_HZ = sound_recorder.RATE_HZ
CLICK_S = 0.25
SHOW = """\
sequence: s
robot: {robot}
sound: clicks.wav
keyframes:
  - {{at_s: 0.0, deg: {{elbow: 0}}}}
  - {{at_s: 2.4, deg: {{elbow: 10}}}}
"""


@pytest.fixture(scope="module")
def server():
    with sound_recorder.sound_server() as environ:
        yield environ


@pytest.fixture
def show(tmp_path):
    """A show with a click every quarter of a second, the first one in its first frame."""
    clicks = np.zeros(6 * RATE_HZ, dtype=np.float32)
    clicks[:: round(CLICK_S * RATE_HZ)] = 0.9
    soundfile.write(tmp_path / "clicks.wav", clicks, RATE_HZ, subtype="FLOAT")
    path = tmp_path / "s.yaml"
    path.write_text(SHOW.format(robot=ROBOT))
    return path


class PausingControls:
    """Connects the recorder, notes the show clock, and pauses at 1.05 s, between two clicks."""

    def __init__(self, recorder):
        self.recorder, self.knots, self.paused_ns, self.is_done = recorder, [], None, False
        self.is_connected = False

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if not self.is_connected:
            self.is_connected = True
            self.recorder.connect(10.0)
        if player.show is None:
            return
        show_s = player.show.show_s(now_ns)
        self.knots.append((now_ns, show_s))
        if self.paused_ns is None and show_s > 1.05:
            self.paused_ns = now_ns
            player.set_rate(0.0, now_ns)
        elif self.paused_ns and not self.is_done and now_ns > self.paused_ns + 900_000_000:
            self.is_done = True
            player.set_rate(1.0, now_ns)


def clicks_of(recorder):
    """Return the instants of the clicks in ns; one between two frames of the device is in both."""
    at_ns, blocks = recorder.samples()
    found = []
    for block_ns, block in zip(at_ns, blocks, strict=True):
        found += [block_ns + frame * 1e9 / RATE_HZ for frame in np.flatnonzero(np.abs(block) > 0.3)]
    found_ns = np.array(found)
    return found_ns[np.diff(found_ns, prepend=-np.inf) > 1_000_000]


def test_clicks_sound_at_their_show_time_before_and_after_a_pause_and_never_after_the_end(
    server, show
):
    robot = lss.load_robot(ROBOT)
    program = lss.compile(lss.plan(lss.load_sequence(show), robot), robot)
    with sound_recorder.Recorder() as recorder:
        steering = PausingControls(recorder)
        result = perform(program, robot, observer=Observer(controls=steering), sound=SoundChoice())
        heard_ns = clicks_of(recorder)
        at_ns, blocks = recorder.samples()
    assert result.report.sound.begun == 1
    assert result.report.warnings == ()
    knots_ns, knots_s = (np.array(column) for column in zip(*steering.knots, strict=True))
    heard_s = np.interp(heard_ns, knots_ns, knots_s)
    off_s = heard_s - np.round(heard_s / CLICK_S) * CLICK_S
    assert len(heard_s) >= 6
    assert heard_s[0] == pytest.approx(0.0, abs=0.005)
    assert heard_s[-1] > 2.0, "it has come back after the pause"
    if not recorder.xruns:  # A device that skips is late by its period, whatever is played.
        assert np.abs(off_s).max() < 0.005
    assert np.median(np.abs(off_s)) < 0.005
    is_over = at_ns > np.interp(2.45, knots_s, knots_ns)
    assert not np.abs(blocks[is_over]).any()


class Seeking(PausingControls):
    """Sends the show back from 1.35 s, and then forward from 1.1 s."""

    def __init__(self, recorder):
        super().__init__(recorder)
        self.seeks, self.sought_ns = [(1.35, 0.45), (1.1, 1.65)], []

    def act(self, player, now_ns):
        self.is_done, self.paused_ns = True, 1  # No pause.
        super().act(player, now_ns)
        if self.seeks and player.phase is Phase.SHOW and self.knots[-1][1] > self.seeks[0][0]:
            if self.sought_ns and now_ns < self.sought_ns[-1] + 300_000_000:
                return  # It brakes.
            player.seek(self.seeks.pop(0)[1], now_ns)
            self.sought_ns.append(now_ns)


def test_clicks_sound_at_their_show_time_where_a_show_is_sent_to(server, show):
    robot = lss.load_robot(ROBOT)
    program = lss.compile(lss.plan(lss.load_sequence(show), robot), robot)
    with sound_recorder.Recorder() as recorder:
        steering = Seeking(recorder)
        result = perform(program, robot, observer=Observer(controls=steering), sound=SoundChoice())
        heard_ns = clicks_of(recorder)
    assert result.report.outcome == "finished"
    assert len(steering.sought_ns) == 2
    knots_ns, knots_s = (np.array(column) for column in zip(*steering.knots, strict=True))
    heard_s = np.interp(heard_ns, knots_ns, knots_s)
    back_ns, forward_ns = steering.sought_ns
    is_back, is_forward = heard_ns > back_ns + 3e8, heard_ns > forward_ns + 3e8
    clicks = np.round(heard_s / CLICK_S).astype(int)
    assert clicks[is_back & ~is_forward].tolist() == [3, 4], "but what is in the ramp of the rate"
    assert clicks[is_forward].tolist() == [8, 9]
    off_s = heard_s - clicks * CLICK_S
    if not recorder.xruns:  # A device that skips is late by its period, whatever is played.
        assert np.abs(off_s).max() < 0.005


def test_nothing_sounds_after_the_player_was_killed(server, show):
    with sound_recorder.Recorder() as recorder:
        with ProgramBeside(command("play", show, "--quiet")) as player:
            recorder.connect(30.0)
            until(lambda: len(clicks_of(recorder)))
            player.kill()
            killed_ns = time.monotonic_ns()
        time.sleep(0.8)
        heard_ns = clicks_of(recorder)
    assert heard_ns[-1] < killed_ns + 150_000_000
