"""Linear timecode as a sound device gets it, read by libltc."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benches import libltc
from lss_motion.sound import device
from lss_motion.stage.timecode import send
from lss_motion.stage.timecode.timecode import FPS_25, read_send
from lss_motion.system.clock_leg import ClockLeg

RATE_HZ = 48000
BLOCK = 1024
BLOCK_NS = BLOCK * 1e9 / RATE_HZ


class Library:
    """A sound library whose device plays what it is given, by an even clock."""

    def __init__(self):
        self.callback, self.samplerate, self.latency = None, RATE_HZ, 0.02

    def OutputStream(self, *, callback, **_):  # noqa: N802  (sounddevice's own name)
        self.callback = callback
        return self

    def start(self):
        pass


@pytest.mark.skipif(bool(libltc.missing()), reason=libltc.missing() or "it is there")
@pytest.mark.parametrize("first_late_ns", [-BLOCK_NS, 0.0, BLOCK_NS])
def test_each_label_ends_when_the_show_is_there_though_first_blocks_are_stated_wrong(
    monkeypatch, first_late_ns
):
    library = Library()
    monkeypatch.setattr(device, "sounddevice_module", lambda: library)
    monkeypatch.setattr(device, "chosen_device", lambda _: SimpleNamespace(name="", rate=RATE_HZ))
    show = send.ShowNow()
    start_ns = 500_000_000  # Of show time 0, on a clock that is 0 at the first block.
    show.take(send.SendLeg(ClockLeg(start_ns - 10**9, -1.0, 1.0, 1.0, 0)))
    send.LtcSender(read_send("ltc"), show)
    sound = []
    for number in range(round(4e9 / BLOCK_NS)):
        late_ns = first_late_ns if number < 4 else 0.0
        monkeypatch.setattr(send.time, "monotonic_ns", lambda n=number: round(n * BLOCK_NS))
        times = SimpleNamespace(currentTime=0.0, outputBufferDacTime=0.1 + late_ns / 1e9)
        block = np.ones((BLOCK, 1), dtype=np.float32)
        library.callback(block, BLOCK, times, None)
        sound.append(block[:, 0])
    heard = np.concatenate(sound)
    read = libltc.read_by_libltc(heard, FPS_25, RATE_HZ)[1:]
    frames = [label.frame(FPS_25) for label, *_ in read]
    assert frames == list(range(frames[0], frames[0] + len(read)))
    assert len(frames) > 60, "nearly three seconds"
    ends_s = np.array([end for *_, end in read]) / RATE_HZ + 0.1 - start_ns / 1e9
    assert np.abs(ends_s - (np.array(frames) + 1) / 25.0).max() < 0.002
    assert np.abs(heard[: RATE_HZ // 2]).max() == 0.0
