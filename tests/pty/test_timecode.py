"""Timecode of other programs, in real time: through JACK's dummy driver, and over the loopback."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from benches import libltc, sound_recorder
from lss_motion.errors import InputError
from lss_motion.stage.timecode.messages import read_artnet, read_fpp
from lss_motion.stage.timecode.source import TimecodeOut, TimecodeSource
from lss_motion.stage.timecode.timecode import (
    ARTNET_PORT,
    FPS_25,
    Timecode,
    read_follow,
    read_send,
    timecode_of,
)
from tests.programs import ProgramBeside, command
from tests.swing import WAIT_S

pytestmark = pytest.mark.realtime
needs_jack = pytest.mark.skipif(
    bool(sound_recorder.missing()), reason=sound_recorder.missing() or "there is one"
)

needs_libltc = pytest.mark.skipif(bool(libltc.missing()), reason=libltc.missing() or "it is there")

DESK = """\
import sys, time, mido
mido.set_backend("mido.backends.rtmidi/UNIX_JACK")
out = mido.open_output("desk", virtual=True, client_name="desk")
print("open", flush=True)
sys.stdin.readline()
start = time.monotonic() + 0.1
print(start, flush=True)
for quarter in range(int(sys.argv[1])):
    frames = 10 * 3600 * 25 + quarter // 8 * 2
    hh, mm, ss, ff = frames // 90000, frames // 1500 % 60, frames // 25 % 60, frames % 25
    values = (ff & 15, ff >> 4, ss & 15, ss >> 4, mm & 15, mm >> 4, hh & 15, hh >> 4 | 1 << 1)
    time.sleep(max(0.0, start + quarter / 100 - time.monotonic()))
    out.send(mido.Message("quarter_frame", frame_type=quarter % 8, frame_value=values[quarter % 8]))
"""
"""A lighting desk: 10:00:00:00 at 25 frames a second, as the standard words it; not our encoder."""

PLAYER = """\
import sys, time, numpy, sounddevice
sound, at = numpy.load(sys.argv[1]), 0
def play(out, count, times, status):
    global at
    part = sound[at : at + count]
    out[: len(part), 0], out[len(part) :, 0] = part, 0.0
    at += count
with sounddevice.OutputStream(samplerate=48000, channels=1, dtype="float32", callback=play):
    print("plays", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(scope="module")
def server():
    with sound_recorder.sound_server() as environ:
        yield environ


@contextlib.contextmanager
def other_program(text, *arguments):
    """Another program; yields it when it has written its first line."""
    words = [sys.executable, "-c", text, *arguments]
    with ProgramBeside(words, stdin=subprocess.PIPE) as child:
        child.wait_for(r"\n")
        yield child


def began(desk):
    """Let a desk begin; return when that was, in s of the clock."""
    desk.stdin.write(b"\n")
    desk.stdin.flush()
    return float(desk.wait_for(r"\S+\n"))


def read_until(source, is_enough):
    """All legs of a source until `is_enough(legs, texts)`."""
    legs, texts, end_s = [], [], time.monotonic() + WAIT_S
    while not is_enough(legs, texts):
        assert time.monotonic() < end_s, (legs[-1:], texts)
        select.select(source.filenos(), [], [], 0.05)
        legs += source.take()
        texts += source.take_texts()
    return legs


def read_for(source, seconds):
    """All legs and texts of a source in that time."""
    legs, texts, end_s = [], [], time.monotonic() + seconds
    while time.monotonic() < end_s:
        select.select(source.filenos(), [], [], 0.05)
        legs += source.take()
        texts += source.take_texts()
    return legs, texts


def followed_desk():
    """Return the legs of a desk, and how late each was in s; wait until its end is noticed."""
    with contextlib.ExitStack() as stack:
        desk = stack.enter_context(other_program(DESK, "3000"))
        spec = read_follow("mtc:desk", offset="10:00:00:00")
        source = stack.enter_context(TimecodeSource(spec))
        start_s = began(desk)
        legs = read_until(
            source,
            lambda legs, _: legs and (legs[-1].state != "locked" or legs[-1].show_s > 2.6),
        )
        desk.kill()
        read_until(source, lambda _, texts: any("is gone" in text for text in texts))
    return legs, [leg.instant_ns / 1e9 - start_s - leg.show_s for leg in legs if leg.show_s > 1]


@pytest.mark.slow
@needs_jack
def test_midi_timecode_of_another_program_is_followed_and_its_end_is_noticed(server):
    pytest.importorskip("rtmidi")
    pytest.importorskip("mido")
    for _ in range(3):
        legs, late_s = followed_desk()
        is_locked = {leg.state for leg in legs} == {"locked"}
        if is_locked and np.ptp(late_s) < 0.02:  # Else a busy machine may have held up the desk.
            break
    assert is_locked
    assert len(late_s) > 10
    # What is sent in a period of JACK (21 ms) comes in the next one.
    assert 0.0 < np.median(late_s) < 0.06
    assert np.ptp(late_s) < 0.02
    assert legs[-1].rate == pytest.approx(1.0, abs=0.005)


@pytest.mark.slow
@needs_jack
@needs_libltc
def test_ltc_of_another_program_is_followed_from_a_sound_input(server, tmp_path):
    labels = [timecode_of(36000 * 25 + n, FPS_25) for n in range(150)]
    sound = np.concatenate([np.zeros(4800), 0.3 * libltc.made_by_libltc(labels, FPS_25, 48000)])
    np.save(tmp_path / "ltc.npy", sound.astype(np.float32))
    with TimecodeSource(read_follow("ltc", offset="10:00:00:00")) as source:
        inputs = jack_ports("PortAudio")
        with other_program(PLAYER, str(tmp_path / "ltc.npy")):
            ports = [port for port in jack_ports("PortAudio") if port not in inputs]
            (out,) = [port for port in ports if ":out" in port]
            (into,) = [port for port in inputs if ":in" in port]
            for speaker in ("system:playback_1", "system:playback_2"):
                jack("jack_disconnect", out, speaker, check=False)
            jack("jack_connect", out, into)
            legs, texts = read_for(source, 4.5)
    locked = [leg for leg in legs if leg.state == "locked"]
    assert len(locked) > 20, texts
    origin_ns = [leg.instant_ns - 1e9 * leg.show_s for leg in locked]
    assert np.ptp(origin_ns[5:]) < 4e6, "the leader runs evenly, as it was played"
    assert locked[-1].rate == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
@needs_jack
@needs_libltc
def test_ltc_that_is_sent_is_read_by_libltc(server):
    for _ in range(3):
        labels, shown_s, dropouts = sent_ltc()
        if not dropouts:  # Of the device, on a busy machine: what was not played cannot be read.
            break
    frames = np.array([label.frame(FPS_25) for label in labels])
    assert len(frames) > 40
    if dropouts:
        assert (np.diff(frames) > 0).all()
        return
    assert (np.diff(frames) == 1).all()
    assert np.abs(shown_s - (frames + 1) / 25.0).max() < 0.01


def sent_ltc():
    """Labels that libltc reads, when each ends in seconds of the show, and dropouts."""
    show = ShowStub(time.monotonic_ns() + 500_000_000)
    with sound_recorder.Recorder() as recorder, TimecodeOut(read_send("ltc")) as out:
        out.turn(show, 0)
        recorder.connect(10.0)
        time.sleep(4.0)
        at_ns, blocks = recorder.samples()
    sound = np.concatenate(blocks)
    read = libltc.read_by_libltc(sound, FPS_25, sound_recorder.RATE_HZ)
    read = [frame for frame in read if frame[0].hours == 0][1:]
    size = len(blocks[0])
    ends_ns = [
        at_ns[min(end // size, len(at_ns) - 1)] + end % size / 48e3 * 1e9 for *_, end in read
    ]
    shown_s = (np.array(ends_ns) - show.start_ns) / 1e9
    return [label for label, *_ in read], shown_s, recorder.xruns


class ShowStub:
    """A player whose show begins at an instant and runs evenly."""

    def __init__(self, start_ns):
        from lss_motion.playing.player.show_clock import ShowClock

        self.start_ns, self.show, self.show_ended_ns = start_ns, self, None
        self.clock = ShowClock(start_ns - 10**9, -1.0, 1.0)


def jack(*words, check=True):
    """Run a program of JACK; return what it prints."""
    done = subprocess.run(words, capture_output=True, text=True, check=check, timeout=WAIT_S)
    return done.stdout


def jack_ports(client):
    return jack("jack_lsp", client).split()


def test_packets_of_others_are_ignored_and_those_of_the_list_followed():
    """Fixtures: there is no independent sender of Art-Net timecode or FPP packets here."""
    here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.bind(("127.0.0.2", 0))
    with here, other, TimecodeSource(read_follow("artnet:127.0.0.1/32")) as source:
        start_s = time.monotonic()
        for number in range(30):
            ss, ff = divmod(number, 25)
            head = b"Art-Net\0\x00\x97\x00\x0e\0\0"
            here.sendto(head + bytes((ff, ss, 0, 0, 1)), ("127.0.0.1", ARTNET_PORT))
            other.sendto(head + bytes((ff, ss, 0, 9, 1)), ("127.0.0.1", ARTNET_PORT))
            here.sendto(os.urandom(40), ("127.0.0.1", ARTNET_PORT))
            time.sleep(max(0.0, start_s + number / 25.0 - time.monotonic()))
        legs, texts = read_for(source, 0.1)
    assert any("127.0.0.2 are ignored" in text for text in texts)
    off_s = [leg.instant_ns / 1e9 - start_s - leg.show_s for leg in legs if leg.state == "locked"]
    assert len(off_s) > 5
    assert max(off_s) < 0.2
    assert {leg.source for leg in legs} == {"127.0.0.1"}


@pytest.mark.slow
def test_what_is_sent_over_the_network_is_in_step_with_the_show():
    packets = {"artnet": [], "fpp": [], "osc": []}
    with contextlib.ExitStack() as stack:
        ears = {}
        for kind in packets:
            ears[kind] = ear = stack.enter_context(socket.socket(type=socket.SOCK_DGRAM))
            ear.bind(("127.0.0.1", 0))
        words = [f"{kind}:127.0.0.1:{ear.getsockname()[1]}" for kind, ear in ears.items()]
        outs = [stack.enter_context(TimecodeOut(read_send(word))) for word in words]
        show = ShowStub(time.monotonic_ns() + 200_000_000)
        for out in outs:
            out.turn(show, 0)
        end_s = time.monotonic() + 1.8
        while (left_s := end_s - time.monotonic()) > 0.0:
            for ear in select.select([*ears.values()], [], [], left_s)[0]:
                kind = next(kind for kind, one in ears.items() if one is ear)
                packets[kind].append((time.monotonic_ns(), ear.recv(2000)))
    art = [(at, read_artnet(data).timecode) for at, data in packets["artnet"]]
    art = [(at - show.start_ns, label) for at, label in art if label.hours == 0]
    late_s = [at / 1e9 - label.at_s(FPS_25) for at, label in art]
    assert len(late_s) > 30
    assert np.median(late_s) == pytest.approx(0.0, abs=0.005)
    fpp = [read_fpp(data) for _, data in packets["fpp"]]
    assert [one.action for one in fpp][:3] == ["open", "start", "sync"]
    from pythonosc.osc_message import OscMessage

    messages = [OscMessage(data) for _, data in packets["osc"]]
    assert {message.address for message in messages} == {"/lss/timecode"}
    text, seconds = messages[-1].params
    assert Timecode(*map(int, text.split(":"))).at_s(FPS_25) == pytest.approx(seconds, abs=1e-4)


@pytest.mark.slow
def test_timecode_that_ends_beyond_the_end_of_the_show_ends_the_program_with_a_code(tmp_path):
    (tmp_path / "show.yaml").write_text(
        "sequence: show\nrobot: robot.yaml\n"
        "keyframes: [{at_s: 0, deg: {j: 0}}, {at_s: 1, deg: {j: 9}}]\n"
    )
    (tmp_path / "robot.yaml").write_text(
        "robot: arm\ndefaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}\n"
        "joints: {j: {id: 1, range_deg: [-90, 90]}}\n"
    )
    follow = ("--follow", "artnet", "--freewheel", "0.5", "--offset-s", "01:00:00:00")
    words = command("play", "show.yaml", *follow)
    with (
        ProgramBeside(words, merged=True, cwd=tmp_path) as child,
        socket.socket(type=socket.SOCK_DGRAM) as desk,
    ):
        child.wait_for("waits for its leader")
        for number in range(20):
            frame = bytes((number, 20, 0, 1, 1))
            packet = b"Art-Net\0\x00\x97\x00\x0e\0\0" + frame
            desk.sendto(packet, ("127.0.0.1", ARTNET_PORT))
            time.sleep(0.04)
        assert child.ended() == 5
    assert "beyond the end of the show, and is gone" in child.said.splitlines()[-1]


def test_a_source_that_is_not_there_says_so():
    with pytest.raises(InputError, match="mtc cannot be followed"):
        TimecodeSource(read_follow("mtc:no such port"))
    for text in ("vitc", "osc:localhost", "fpp:", "osc:h:99999", "mtc"):
        with pytest.raises(InputError):
            read_send(text, rate="23.976") if text == "mtc" else read_send(text)
    for text in ("midi", "artnet:300.1.1.1", "fpp:a,b"):
        with pytest.raises(InputError):
            read_follow(text)
    assert read_follow("artnet:10.0.0.0/8,127.0.0.1").allowed == ("10.0.0.0/8", "127.0.0.1")
    assert not read_follow("artnet:10.0.0.0/8,127.0.0.1").is_loopback
