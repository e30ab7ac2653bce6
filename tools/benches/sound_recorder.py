"""A sound server without hardware (JACK's dummy driver), and a recording of what it would play.

    with sound_server():                          jackd
        with Recorder() as recorder:              records the first channel of PortAudio
            recorder.connect()                    once the player has opened its stream
            ...
            recorder.samples()                    instants in ns of the computer's clock, values

The instant of a sample is that at which the dummy device would play it, by the clock of the sound
server, which is that of the computer. It does not come from the player. The recording runs in a
process of its own, since a device waits for all that record it.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import os
import pickle
import select
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

INSTALL = "sudo apt install libportaudio2 jackd2"
RATE_HZ = 48000
PERIOD_FRAMES = 1024
FLOATS = b"32 bit float mono audio"
IS_INPUT = 1
PLAYBACK_LATENCY = 1
NUMBERS = count()
"""No server of a process has the name of one before: JACK's library, once a client of that, would
be connected to the new one, and get no data."""
END_S = 10.0
"""The longest time that a program of the sound server may take to end."""
ANSWER_S = 30.0
"""The longest time that the recorder may take for an answer."""
SKIP_NS = 2_000_000
"""A larger change from one block to the next is a dropout."""


def missing() -> str:
    """Return why there is no sound server to test with; empty if there is one."""
    if shutil.which("jackd") is None or ctypes.util.find_library("jack") is None:
        return f"no sound server to record: {INSTALL}"
    if ctypes.util.find_library("portaudio") is None:
        return f"no PortAudio: {INSTALL}"
    return ""


@contextlib.contextmanager
def sound_server() -> Iterator[dict[str, str]]:
    """Run a sound server without hardware; yield the environment for its clients."""
    name = f"lssmotion{os.getpid()}_{next(NUMBERS)}"
    environ = {
        "JACK_DEFAULT_SERVER": name,
        "JACK_NO_START_SERVER": "1",
        "JACK_NO_AUDIO_RESERVATION": "1",
    }
    driver = ["-n", name, "-d", "dummy", "-r", str(RATE_HZ), "-p", str(PERIOD_FRAMES)]
    with tempfile.TemporaryFile() as output:
        for how in (["-R", "-P", "10"], ["-r"]):
            server = subprocess.Popen(
                ["jackd", *how, *driver],
                env={**os.environ, **environ},
                stdout=output,
                stderr=output,
            )
            if _is_up(server, environ):
                break
            _end(server)
        else:
            output.seek(0)
            raise OSError(f"jackd does not start: {output.read().decode()[-300:]}")
        before = {key: os.environ.get(key) for key in environ}
        os.environ.update(environ)
        try:
            yield environ
        finally:
            for key, value in before.items():
                os.environ.pop(key, None)
                if value is not None:
                    os.environ[key] = value
            _end(server)


def _end(server: subprocess.Popen[bytes]) -> None:
    server.terminate()
    try:
        server.wait(END_S)
    except subprocess.TimeoutExpired:
        server.kill()
        server.wait(END_S)


def _is_up(server: subprocess.Popen[bytes], environ: dict[str, str]) -> bool:
    end_s = time.monotonic() + 5.0
    while time.monotonic() < end_s and server.poll() is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            listed = subprocess.run(
                ["jack_lsp"],
                env={**os.environ, **environ},
                capture_output=True,
                check=False,
                timeout=END_S,
            )
            if b"system:playback_1" in listed.stdout:
                return True
        time.sleep(0.05)
    return False


def evened_ns(frames: np.ndarray, stated_ns: np.ndarray) -> np.ndarray:
    """Return when frames are played, from what the server stated as they were recorded.

    Its clock is the computer's, so between two dropouts frames are evenly spaced. What it states
    comes near that within a second after its start, and is right in the second half of each part.
    """
    if len(frames) == 0:
        return stated_ns
    even_ns = frames * (1e9 / RATE_HZ)
    off_ns = stated_ns - even_ns
    jumps = np.flatnonzero(np.abs(np.diff(off_ns)) > SKIP_NS) + 1
    parts = np.split(off_ns, jumps)
    settled_ns = [np.full(len(part), np.median(part[len(part) // 2 :])) for part in parts]
    return np.round(even_ns + np.concatenate(settled_ns)).astype(np.int64)


class Recorder:
    """Records one channel of a client of the sound server. A context manager."""

    def __init__(self) -> None:
        self.xruns = 0
        """Dropouts of the device, as of the last `samples`."""

    def __enter__(self) -> Recorder:
        self._child = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self._ask("ready") is True, "no sound server"
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._child.communicate(timeout=END_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.communicate(timeout=END_S)

    def connect(self, wait_s: float = 10.0, source: str = "PortAudio:out_0") -> None:
        """Record this port, once it is there."""
        end_s = time.monotonic() + wait_s
        while not self._ask(f"connect {source}"):
            assert time.monotonic() < end_s, f"nothing plays as {source}"
            time.sleep(0.02)

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the instant of each block's first frame in ns, and the blocks."""
        self.xruns, numbers, stated_ns, blocks = self._ask("samples")
        at_ns = evened_ns(np.array(numbers, dtype=np.int64), np.array(stated_ns, dtype=np.int64))
        return at_ns, np.array([np.frombuffer(block, dtype=np.float32) for block in blocks])

    def _ask(self, question: str) -> Any:  # noqa: ANN401  (three kinds of answers)
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(question.encode() + b"\n")
        self._child.stdin.flush()
        if not select.select([self._child.stdout], [], [], ANSWER_S)[0]:
            raise TimeoutError(f"the recorder does not answer {question!r} within {ANSWER_S:g} s")
        return pickle.load(self._child.stdout)  # noqa: S301  (our own process)


class _Range(ctypes.Structure):
    _fields_ = (("least", ctypes.c_uint32), ("most", ctypes.c_uint32))


_PROCESS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_uint32, ctypes.c_void_p)
_XRUN = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)


class _Client:
    """The client of the sound server, in the process of the recording."""

    def __init__(self) -> None:
        self.blocks: list[tuple[int, int, bytes]] = []
        """Number of the first frame of each block, when it is played by the clock of the server in
        us, and the block. It is asked at once: after a dropout the server counts anew."""
        self.xruns = 0
        self._jack = jack = ctypes.CDLL(ctypes.util.find_library("jack"))
        for name, kind in (
            ("jack_client_open", ctypes.c_void_p),
            ("jack_port_register", ctypes.c_void_p),
            ("jack_port_name", ctypes.c_char_p),
            ("jack_port_by_name", ctypes.c_void_p),
            ("jack_port_get_buffer", ctypes.c_void_p),
            ("jack_last_frame_time", ctypes.c_uint32),
            ("jack_frames_to_time", ctypes.c_uint64),
            ("jack_get_time", ctypes.c_uint64),
        ):
            getattr(jack, name).restype = kind
        self._process, self._xrun = _PROCESS(self._take), _XRUN(self._count_xrun)
        self._client = ctypes.c_void_p(jack.jack_client_open(b"recorder", 1, None))
        if not self._client:
            return
        port = jack.jack_port_register(self._client, b"in", FLOATS, IS_INPUT, 0)
        self._port = ctypes.c_void_p(port)
        jack.jack_set_process_callback(self._client, self._process, None)
        jack.jack_set_xrun_callback(self._client, self._xrun, None)
        latency = _Range()
        speaker = ctypes.c_void_p(jack.jack_port_by_name(self._client, b"system:playback_1"))
        jack.jack_port_get_latency_range(speaker, PLAYBACK_LATENCY, ctypes.byref(latency))
        self._latency_frames = latency.most
        # Its clock is that of the computer; measured, because it might be another.
        self._origin_ns = time.monotonic_ns() - 1000 * jack.jack_get_time()
        jack.jack_activate(self._client)

    def answer(self, question: str) -> Any:  # noqa: ANN401
        word, _, source = question.partition(" ")
        if word == "ready":
            return bool(self._client)
        if word == "connect":
            own = self._jack.jack_port_name(self._port)
            return self._jack.jack_connect(self._client, source.encode(), own) == 0
        recorded = list(self.blocks)
        at_ns = [self._origin_ns + 1000 * at_us for _, at_us, _ in recorded]
        frames, blocks = [one for one, *_ in recorded], [data for *_, data in recorded]
        return self.xruns, frames, at_ns, blocks

    def _take(self, count: int, _: object) -> int:
        buffer = self._jack.jack_port_get_buffer(self._port, count)
        frame = self._jack.jack_last_frame_time(self._client)
        at_us = self._jack.jack_frames_to_time(self._client, frame + self._latency_frames)
        self.blocks.append((frame, at_us, ctypes.string_at(buffer, 4 * count)))
        return 0

    def _count_xrun(self, _: object) -> int:
        self.xruns += 1
        return 0


def main() -> None:
    """Answer the questions of a `Recorder` until standard input ends."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    client, answers = _Client(), sys.stdout.buffer
    for line in sys.stdin:
        answers.write(pickle.dumps(client.answer(line.strip())))
        answers.flush()


if __name__ == "__main__":
    main()
