"""What the studio costs a show: lateness with four clients against none, the server; and E-stop.

The show plays in its own process on a robot behind a pseudo-terminal (`behind_pty`), started by a
real server. With four clients, each reads all telemetry and events over its websocket, in one
process of their own; with none, the client that has started the show leaves. Rounds alternate. The
instants are those at which the servos received the last byte of a move. When the show began is not
known there, so lateness is counted from the most punctual hundredth of the moves of a round.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace
from websockets.sync.client import connect

from benches.behind_pty import robot_behind_pty
from benches.late import lateness
from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.playing import api
from lss_motion.show.write import write_sequence
from lss_motion.units import NS_PER_MS, NS_PER_US, line_time_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from benches.behind_pty import Heard
    from lss_motion.planning.program.model import Program
    from lss_motion.robot.model import Robot

SERVOS: Final = 18
SHOW_S: Final = 10.0
ROUNDS: Final = 4
CLIENTS: Final = 4
MORE_MAX: Final = 1.10
"""`studio.md`, accepted when: less than 10 % more."""
WAIT_S: Final = 60.0
PUNCTUAL: Final = 1.0
"""Percentile of the moves of a round."""
ESTOP_MAX_MS: Final = 100.0
"""`studio.md`, accepted when."""
SAFE: Final = b"#254H\r"
STRAY_MAX_US: Final = 200_000.0
MOVE: Final = re.compile(rb"#(\d+)D-?\d+T")
TICKS_HZ: Final = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Round:
    """One show: how late its moves were, and what the server used meanwhile."""

    late_us: np.ndarray
    server_ratio: float
    player_ratio: float


def measure(rounds: int = ROUNDS) -> list[Row]:
    """Return lateness with and without clients, and what the processes of the studio need."""
    robot = robot_of(SERVOS)
    show = lively_show(robot, SHOW_S, seed=4)
    program = api.compile(api.plan(show, robot), robot)
    with tempfile.TemporaryDirectory() as text, robot_behind_pty(robot) as (real, received):
        folder = Path(text)
        (folder / "robot.yaml").write_text(robot_text(real))
        show_file = replace(show, robot_path=folder / "robot.yaml")
        write_sequence(show_file, folder / "show.yaml")
        with _studio(folder) as (server, info):
            alone, watched = [], []
            for _ in range(rounds):
                for side, count in ((alone, 0), (watched, CLIENTS)):
                    received()
                    used = _play(server, info, count)
                    side.append(Round(_late_us(program, real, received()), *used))
            memory = _memory_rows(server)
            stops = [_estop_row(info, way, received) for way in ("stop", "addresses", "websocket")]
    return [_late_row(alone, watched), *stops, *_use_rows(alone, watched), *memory]


def measure_short() -> list[Row]:
    """Return the same from two rounds."""
    return measure(2)


def _late_row(alone: list[Round], watched: list[Round]) -> Row:
    def said(side: list[Round]) -> tuple[str, float]:
        late_us = np.concatenate([one.late_us for one in side])
        quantiles = np.percentile(late_us, (50.0, 99.0, 99.9))
        judged_us = statistics.median(float(np.percentile(one.late_us, 99.0)) for one in side)
        text = ", ".join(f"{value:.0f}" for value in quantiles)
        return f"{text} us; p99 of the median round {judged_us:.0f} us", judged_us

    (ours, watched_us), (reference, alone_us) = said(watched), said(alone)
    count = sum(len(one.late_us) for one in watched)
    return Row(
        what=f"four clients watch: late at the servo, p50, p99, p99.9 of {count}",
        ours=ours,
        reference=f"{reference} without any",
        ratio=watched_us / alone_us,
        target=f"p99 of the median round <= {MORE_MAX:g} x",
        is_met=watched_us <= MORE_MAX * alone_us,
    )


def _use_rows(alone: list[Round], watched: list[Round]) -> list[Row]:
    rows = []
    for what in ("server", "player"):
        ours, reference = (
            statistics.median(getattr(one, f"{what}_ratio") for one in side)
            for side in (watched, alone)
        )
        rows.append(
            Row(
                what=f"{what} while a show of {SERVOS} servos plays, four clients, share of a core",
                ours=f"{ours:.1%}",
                reference=f"{reference:.1%} without any",
            )
        )
    return rows


def _memory_rows(server: subprocess.Popen[str]) -> list[Row]:
    pids = {"server": server.pid} | _children(server.pid)
    names = {"server": "server", "stop": "stop process", "planner": "planner"}
    return [
        Row(what=f"memory of the {name}", ours=f"{_memory_mb(pids[key]):.0f} MB")
        for key, name in names.items()
    ]


def _estop_row(info: dict[str, Any], way: str, received: Callable[[], Heard]) -> Row:
    """Return how long an emergency stop takes from its sender to the servos."""
    with _link(info) as link:
        link.send('{"op": "lease", "want": "take"}')
        _begin(link)
        time.sleep(2.0)
        received()
        sent_ns = time.monotonic_ns()
        if way == "websocket":
            link.send('{"op": "estop"}')
        else:
            origin = info["stop"] if way == "stop" else info["addresses"][0]
            # The address is that of our own server.
            asked = urllib.request.Request(origin + "/estop", b"", _headers(info))  # noqa: S310
            urllib.request.urlopen(asked, timeout=WAIT_S).close()  # noqa: S310
        _wait(link, lambda e: e["event"] == "player" and e["state"] == "ended")
        link.send('{"op": "rearm"}')
        _wait(link, lambda e: e["event"] == "player" and not e["is_latched"])
    last_ns, line = received()[-1]
    assert line == SAFE, "the last bytes are not the safe ones"
    took_ms = (last_ns - sent_ns) / NS_PER_MS
    names = {"stop": "process that stops", "addresses": "server", "websocket": "websocket"}
    return Row(
        what=f"E-stop by the {names[way]}: until the safe bytes are at the servos",
        ours=f"{took_ms:.0f} ms",
        ratio=took_ms / ESTOP_MAX_MS,
        target=f"<= {ESTOP_MAX_MS:g} ms on an idle machine",
        is_met=took_ms <= ESTOP_MAX_MS,
    )


# ---- the studio


@contextlib.contextmanager
def _studio(folder: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    words = [sys.executable, "-m", "lss_motion.cli.start", "studio", str(folder / "show.yaml")]
    server = subprocess.Popen([*words, "--json"], stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    text = ""
    while not text.endswith("}\n"):
        text += server.stdout.readline()
    try:
        yield server, json.loads(text)
    finally:
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=WAIT_S)


def _play(server: subprocess.Popen[str], info: dict[str, Any], clients: int) -> tuple[float, float]:
    """Play the show to its end; return what server and player used of a core meanwhile."""
    watching = _CONTEXT.Process(target=_watch, args=(info, clients)) if clients else None
    if watching is not None:
        watching.start()
    with _link(info) as link:
        _wait(link, lambda e: e["event"] == "document" and e["plan"] is not None)
        _begin(link)
    player = _children(server.pid)["process"]
    before, began_s = [_used_s(pid) for pid in (server.pid, player)], time.monotonic()
    time.sleep(SHOW_S - 1.0)
    took_s = time.monotonic() - began_s
    after = [_used_s(pid) for pid in (server.pid, player)]
    with _link(info) as link:
        _wait(link, lambda e: e["event"] == "player" and e["state"] == "ended")
    if watching is not None:
        watching.terminate()
        watching.join()
    server_ratio, player_ratio = (
        (end - start) / took_s for start, end in zip(before, after, strict=True)
    )
    return server_ratio, player_ratio


def _link(info: dict[str, Any]) -> Any:  # noqa: ANN401  (a context manager of websockets)
    address = info["addresses"][0].replace("http", "ws") + "/ws"
    return connect(address, additional_headers=_headers(info), compression=None)


def _begin(link: Any) -> None:  # noqa: ANN401
    """Let the show begin; the robot counts as real, so it waits for `go`."""
    link.send('{"op": "play"}')
    _wait(link, lambda e: e["event"] == "player" and e["state"] == "ready")
    link.send('{"op": "go"}')
    _wait(link, lambda e: e["event"] == "player" and e["state"] == "playing")


def _headers(info: dict[str, Any]) -> dict[str, str]:
    return {"Authorization": f"Bearer {info['token']}"}


def _wait(link: Any, is_wanted: Any) -> None:  # noqa: ANN401
    end_s = time.monotonic() + WAIT_S
    told = []
    while time.monotonic() < end_s:
        message = link.recv(timeout=WAIT_S)
        if not isinstance(message, str):
            continue
        if is_wanted(json.loads(message)):
            return
        if "heartbeat" not in message:
            told.append(message[:300])
    raise TimeoutError("\n".join(told))


def _watch(info: dict[str, Any], clients: int) -> None:
    """Read everything that the server sends, over so many links."""
    from websockets.asyncio.client import connect as connect_async

    async def read() -> None:
        address = info["addresses"][0].replace("http", "ws") + "/ws"
        async with connect_async(address, additional_headers=_headers(info)) as link:
            async for _ in link:
                pass

    async def read_all() -> None:
        await asyncio.gather(*(read() for _ in range(clients)))

    asyncio.run(read_all())


_CONTEXT: Final = multiprocessing.get_context("spawn")


def _children(pid: int) -> dict[str, int]:
    """Return the processes that the server has started, by the module that they run."""
    found = {}
    for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        with contextlib.suppress(OSError, ValueError):
            words = Path(f"/proc/{one}/cmdline").read_bytes().decode().split("\0")
            found[words[words.index("-c") + 3].rpartition(".")[2]] = int(one)
    return found


def _used_s(pid: int) -> float:
    """Return the processor time of a process so far."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICKS_HZ


def _memory_mb(pid: int) -> float:
    text = Path(f"/proc/{pid}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", text)
    assert found is not None
    return int(found[1]) / 1000.0


# ---- at the servos


def robot_text(robot: Robot) -> str:
    [bus] = robot.buses.values()
    joints = "".join(
        f"  {j.name}: {{id: {j.servo_id}, model: {j.model.name}, "
        f"range_deg: [{j.position_min_deg:g}, {j.position_max_deg:g}], "
        f"speed_max_deg_s: {j.speed_max_deg_s:g}, accel_max_deg_s2: {j.accel_max_deg_s2:g}}}\n"
        for j in robot.joints.values()
    )
    return (
        f"robot: {robot.name}\n"
        f"buses:\n  main: {{port: {bus.port}, baud_bps: {bus.baud_bps}, "
        f"firmware: {bus.firmware}}}\n"
        f"joints:\n{joints}"
    )


def _late_us(program: Program, robot: Robot, heard: Heard) -> np.ndarray:
    """Return how late each move was received, from the most punctual hundredth on."""
    [bus] = robot.buses.values()
    last_ns = {
        int(match[1]): instant_ns
        for instant_ns, line in heard
        if (match := MOVE.match(line)) is not None
    }
    ends_ns = {
        move.servo_id: move.due_us * NS_PER_US + line_time_ns(len(move.data), bus.baud_bps)
        for move in program.moves
    }
    # The last move of a servo is received once: it says about when the show began.
    began_ns = int(statistics.median(last_ns[one] - end_ns for one, end_ns in ends_ns.items()))
    dues_ns = [began_ns + move.due_us * NS_PER_US for move in program.moves]
    late_us: np.ndarray = lateness(program, (robot, lambda: heard), dues_ns).us
    assert abs(np.median(late_us)) < STRAY_MAX_US, "the moves are not those of the show"
    return late_us - np.percentile(late_us, PUNCTUAL)
