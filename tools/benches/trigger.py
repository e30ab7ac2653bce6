"""From a trigger to the first byte of a move at the servos, through the whole of `serve`.

A stage stands, without an idle show. A program sends an OSC message, an HTTP request or a MIDI note
(through JACK without hardware, which hands it over in the next period); the show of its cue begins
where the robot stands. Counted is from before the message is sent until the first move has arrived
at the servos, which are simulated behind a pseudo-terminal (`behind_pty`), once beside nothing and
once beside one busy process on each core.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from benches import sound_recorder
from benches.behind_pty import busy_cores, robot_behind_pty
from benches.shows import robot_of
from benches.studio import robot_text
from benches.table import Row
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from benches.behind_pty import Heard

SERVOS: Final = 6
TIMES: Final = 10
TIMES_BUSY: Final = 4
NOTE: Final = (0x90, 60, 100)
WAIT_S: Final = 60.0
SHOW: Final = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {{at_s: 0, deg: {start}}}
  - {{at_s: 0.4, deg: {turned}}}
  - {{at_s: 0.8, deg: {start}}}
"""
STAGE: Final = """\
stage: bench
robot: robot.yaml
shows: {{nod: nod.yaml}}
cues:
  - {{cue: osc, on: {{osc: /nod}}, play: nod}}
  - {{cue: web, on: {{http: nod}}, play: nod}}
  - {{cue: keys, on: {{note: 60}}, play: nod}}
listen: {{osc: "127.0.0.1:{osc}", http: "127.0.0.1:{http}"{midi}}}
log: {{ring_s: 0}}
"""


def measure(times: int = TIMES, times_busy: int = TIMES_BUSY) -> list[Row]:
    """Return how long triggers take, by OSC, HTTP and MIDI, with and without other load."""
    robot = replace(robot_of(SERVOS))
    with (
        tempfile.TemporaryDirectory() as text,
        robot_behind_pty(robot) as (real, received),
        _piano() as play_note,
    ):
        folder = Path(text)
        (folder / "robot.yaml").write_text(robot_text(real))
        start = json.dumps(dict.fromkeys(real.joints, 0.0)).replace('"', "")
        turned = json.dumps(dict.fromkeys(real.joints, 5.0)).replace('"', "")
        (folder / "nod.yaml").write_text(SHOW.format(start=start, turned=turned))
        with _stage(folder, has_midi=play_note is not None) as (info, osc):
            send = {"OSC": lambda: _send_osc(osc), "HTTP": lambda: _post(info, "/trigger/nod")}
            if play_note is not None:
                send["MIDI"] = play_note
            rows = []
            for load in ("nothing", "a busy process on each core"):
                with contextlib.ExitStack() as stack:
                    is_busy = load != "nothing"
                    if is_busy:
                        stack.enter_context(busy_cores())
                    for way, do in send.items():
                        count = times_busy if is_busy else times
                        taken = [_once(info, received, do) for _ in range(count)]
                        rows.append(_row(way, load, taken))
    return rows


@contextlib.contextmanager
def _piano() -> Iterator[Callable[[], None] | None]:
    """Yield what plays a note, on a keyboard that the stage can open; None: there is no MIDI."""
    if sound_recorder.missing() or importlib.util.find_spec("rtmidi") is None:
        yield None
        return
    import rtmidi

    with sound_recorder.sound_server():
        piano = rtmidi.MidiOut(rtapi=rtmidi.API_UNIX_JACK, name="piano")
        piano.open_virtual_port("keys")
        try:
            yield lambda: piano.send_message(NOTE)
        finally:
            piano.close_port()
            piano.delete()


def _row(way: str, load: str, taken_ms: list[float]) -> Row:
    p50, p99, most = np.percentile(taken_ms, (50, 99, 100))
    return Row(
        what=f"from {way} to the first move at the servos, beside {load}",
        ours=f"p50 {p50:.1f}, p99 {p99:.1f}, max {most:.1f} ms ({len(taken_ms)} times)",
    )


def _once(info: dict[str, Any], received: Callable[[], Heard], do: Callable[[], None]) -> float:
    """Return the milliseconds from one trigger to the first move."""
    _wait_for(info, lambda state: state["show"] is None and state["state"] == "idle")
    time.sleep(0.2 + random.random() * 0.3)  # noqa: S311  (at any place of the polling)
    received()
    sent_ns = time.monotonic_ns()
    do()
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s:
        time.sleep(0.1)
        moves = [at_ns for at_ns, line in received() if b"D" in line and b"Q" not in line]
        if moves:
            return (moves[0] - sent_ns) / NS_PER_MS
    raise TimeoutError("the show did not begin")


@contextlib.contextmanager
def _stage(folder: Path, *, has_midi: bool) -> Iterator[tuple[dict[str, Any], int]]:
    osc, http = _free_port(socket.SOCK_DGRAM), _free_port(socket.SOCK_STREAM)
    midi = ", midi: piano" if has_midi else ""
    (folder / "bench.yaml").write_text(STAGE.format(osc=osc, http=http, midi=midi))
    words = [sys.executable, "-m", "lss_motion.cli.start", "serve", str(folder / "bench.yaml")]
    server = subprocess.Popen(
        [*words, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "LSS_MOTION_STATE_DIR": str(folder)},
    )
    assert server.stdout is not None
    text = ""
    while not text.endswith("}\n"):
        text += server.stdout.readline()
    try:
        yield json.loads(text), osc
    finally:
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=WAIT_S)


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as own:
        own.bind(("127.0.0.1", 0))
        return int(own.getsockname()[1])


def _send_osc(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.sendto(b"/nod\0\0\0\0,\0\0\0", ("127.0.0.1", port))


def _post(info: dict[str, Any], path: str, method: str = "POST") -> Any:  # noqa: ANN401
    request = urllib.request.Request(  # noqa: S310  (our own server)
        info["addresses"][0] + path,
        headers={"Authorization": f"Bearer {info['token']}"},
        method=method,
    )
    with urllib.request.urlopen(request, timeout=WAIT_S) as answer:  # noqa: S310
        return json.loads(answer.read())


def _wait_for(info: dict[str, Any], is_met: Callable[[dict[str, Any]], bool]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not is_met(_post(info, "/state", "GET")):
        if time.monotonic() > end_s:
            raise TimeoutError("the stage is not ready")
        time.sleep(0.05)
