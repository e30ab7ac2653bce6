"""Timecode into a stage that is served: judged at the bytes that a servo receives, in real time."""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from benches import libltc, sound_recorder
from lss_motion.stage.check import plan_stage
from lss_motion.stage.load import load_stage
from lss_motion.stage.timecode.timecode import FPP_PORT, FPS_25, timecode_of
from tests.pty.test_serve import halls, until
from tests.pty.test_timecode import DESK, PLAYER, began, jack, jack_ports, other_program

pytestmark = [pytest.mark.realtime, pytest.mark.slow]
needs_jack = pytest.mark.skipif(
    bool(sound_recorder.missing() or libltc.missing()),
    reason=sound_recorder.missing() or libltc.missing() or "they are there",
)
NS = 1_000_000_000
BEGIN_S = 3.0
STAGE = """\
stage: hall
robot: arm.yaml
shows: {{idle: idle.yaml, dance: dance.yaml}}
idle: idle
cues:
  - {{cue: song, on: {{timecode: "00:00:03:00"}}, play: dance, start: terminate, ready: true}}
sync: {{timecode: {{source: SOURCE, rate_fps: 25, OFFSET, freewheel_s: 1, lost: hold}}}}
listen: {{http: "127.0.0.1:{http}", osc: "127.0.0.1:{osc}"}}
log: {{ring_s: 0}}
"""
MOVE = re.compile(rb"#1D(-?\d+)T")


@pytest.fixture
def hall():
    with halls() as start:
        yield start


def started(hall, source, offset_s=36000.0):
    """A stage that waits at the start of its show."""
    keys = "".join(
        f"  - {{at_s: {at_s}, deg: {{a: {(10 + at_s) * (-1) ** at_s}}}}}\n" for at_s in range(26)
    )
    Path("dance.yaml").write_text(f"sequence: dance\nrobot: arm.yaml\nkeyframes:\n{keys}")
    own = hall(stage=STAGE.replace("SOURCE", source).replace("OFFSET", f"offset_s: {offset_s}"))
    own.waits_for(show="dance", state="idle")
    until(lambda: own.said("waits for its leader"))
    return own


def late_ms(bus, at_s, from_s, to_s, began_ns):
    """How late each move came, by the timecode, which is at `at_s(seconds since began_ns)`."""
    program = plan_stage(load_stage(Path("hall.yaml"))).shows["dance"].program
    found = []
    for ns, line in list(bus.lines):
        since_s = (ns - began_ns) / NS
        if (move := MOVE.match(line)) and from_s <= since_s < to_s:
            show_s = at_s(since_s) - BEGIN_S
            near = [m.due_us / 1e6 for m in program.moves if abs(m.target_wire - int(move[1])) <= 2]
            found.append(1000.0 * min((show_s - due_s for due_s in near), key=abs, default=np.inf))
    return np.array(found)


class Fpp:
    """A Falcon player: packets by the layout of its documents, ten a second."""

    def __init__(self, host="127.0.0.1"):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, 0))

    def send(self, seconds, action=2):
        body = struct.pack("<BBIf", action, 0, int(seconds * 25), seconds) + b"song.fseq\0"
        packet = b"FPPD" + struct.pack("<BH", 1, len(body)) + body
        self.socket.sendto(packet, ("127.0.0.1", FPP_PORT))

    def run(self, began_s, at_s, until_s, other=None):
        """Send where it is until so long after `began_s`; another one disturbs."""
        while (since_s := time.monotonic() - began_s) < until_s:
            self.send(at_s(since_s))
            if other is not None:
                other.send(at_s(since_s) + 100.0)
            time.sleep(0.1)


def test_a_falcon_player_leads_a_stage_from_its_first_move_through_a_jump_and_into_silence(
    on_terminal,
    servo,
    hall,
):
    def at_s(seconds):
        return seconds if seconds < 9.0 else seconds + 4.0

    with on_terminal(servo(1)) as bus, contextlib.ExitStack() as stack:
        own = started(hall, "fpp", 0.0)
        player, other = Fpp(), Fpp("127.0.0.2")
        stack.callback(player.socket.close)
        stack.callback(other.socket.close)
        began_s = time.monotonic()
        player.run(began_s, at_s, 5.0)
        player.run(began_s, at_s, 15.0, other)
        until(lambda: own.ask("/state")["timecode"]["state"] == "lost")
        time.sleep(2.0)  # It brakes.
        count = len(bus.lines)
        time.sleep(1.0)
        moves = [line for _, line in list(bus.lines)[count:] if MOVE.match(line)]
        began_ns = round(began_s * NS)
        first = late_ms(bus, at_s, 2.9, 8.9, began_ns)
        assert len(first) >= 8
        assert np.abs(np.median(first)) < 30.0
        assert np.abs(first).max() < 120.0, "it begins with the first move"
        assert own.said("rejoins it") or own.said("jumps by")
        later = late_ms(bus, at_s, 13.5, 15.0, began_ns)
        assert len(later) >= 2
        assert np.abs(np.median(later)) < 30.0
        assert len(moves) <= 1, "the robot holds"
        assert own.said("127.0.0.2") or own.said("is ignored")


@needs_jack
@pytest.mark.parametrize("source", ["mtc", "ltc"])
def test_timecode_of_another_program_leads_a_stage_through_jack(
    on_terminal,
    servo,
    hall,
    source,
    tmp_path,
):
    pytest.importorskip("rtmidi")
    with sound_recorder.sound_server(), on_terminal(servo(1)) as bus:
        with contextlib.ExitStack() as stack:
            if source == "mtc":
                desk = stack.enter_context(other_program(DESK, "900"))
                started(hall, "mtc")
                began_ns = round(began(desk) * NS)
            else:
                started(hall, "ltc")
                labels = [timecode_of(36000 * 25 + n, FPS_25) for n in range(250)]
                sound = 0.3 * libltc.made_by_libltc(labels, FPS_25, 48000)
                lead = np.zeros(48000)
                np.save(tmp_path / "ltc.npy", np.concatenate([lead, sound]).astype(np.float32))
                inputs = jack_ports("PortAudio")
                stack.enter_context(other_program(PLAYER, str(tmp_path / "ltc.npy")))
                began_ns = time.monotonic_ns() + NS
                (out,) = [p for p in jack_ports("PortAudio") if p not in inputs and ":out" in p]
                (into,) = [p for p in inputs if ":in" in p]
                jack("jack_connect", out, into)
            time.sleep(9.0)
        late = late_ms(bus, lambda seconds: seconds, 2.5, 9.0, began_ns)
        assert len(late) >= 8
        assert -60.0 < np.median(late) < 120.0, "the way through the sound server, and what starts"
        assert np.percentile(np.abs(late - np.median(late)), 80) < 15.0, "it runs evenly"
