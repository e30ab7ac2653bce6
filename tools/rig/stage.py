"""A stage in network namespaces: one for each host, a bridge between them, faults on demand.

with RigStage(folder, hosts=3, seed=7, line=WIFI) as rig:
    rig.start_all()
    rig.wait("f0", "all stand at the start", 60)
    rig.cut("f1"); rig.heal("f1"); rig.kill("f2"); rig.start("f2"); rig.jump("f1", 10**8)
    verdicts = rig.end_robots()  # what the judge objects to, by host
    rig.start_robots()           # and another show, with the same hosts
    verdicts = rig.end()
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import TracebackType

TOOLS: Final = Path(__file__).resolve().parents[1]
PLAIN: Final = ("0.1", "0.05", "0", "0", "0")
WIFI: Final = ("0.5", "3", "0.02", "80", "0.005")
"""Of a line: base and jitter in ms, share and size in ms of spikes, share of losses."""

CAP_NET_ADMIN: Final = 12
CAP_SYS_ADMIN: Final = 21
"""Of capabilities(7): bits of the rights of a process."""

ROBOT: Final = """\
robot: {name}
buses: {{main: {{port: "sim://", baud_bps: 115200, firmware: 370}}}}
defaults: {{model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}}
joints:
{joints}
"""
CUES: Final = """\
cues:
  - {cue: show, on: {key: a}, play: show}
  - {cue: more, on: {key: b}, play: more, start: interrupt}
"""


def may_make_namespaces() -> bool:
    """Return whether this process may make network namespaces; root in a container may not."""
    status = Path("/proc/self/status")
    if not status.exists() or os.geteuid() != 0:
        return False
    found = re.search(r"^CapEff:\s*([0-9a-f]+)$", status.read_text(), re.MULTILINE)
    held = int(found[1], 16) if found else 0
    return all(held >> capability & 1 for capability in (CAP_NET_ADMIN, CAP_SYS_ADMIN))


def why_not() -> str:
    """Return why there can be no rig here; empty: there can."""
    if not may_make_namespaces():
        return "network namespaces need Linux and root with CAP_NET_ADMIN and CAP_SYS_ADMIN"
    if shutil.which("ip") is None:
        return "network namespaces need `ip` (Debian: iproute2)"
    name = f"lsstry{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
    return "" if made.returncode == 0 else f"no network namespace: {made.stderr.strip()}"


class RigStage:
    """Namespaces and processes of one stage; `with` removes all of them."""

    def __init__(  # noqa: PLR0913  (what one stage has)
        self,
        folder: Path,
        *,
        hosts: int = 3,
        joints: int = 2,
        seed: int = 0,
        line: Sequence[str] = PLAIN,
        show_s: float = 8.0,
        loops: int = 1,
        others: str = "hold",
        freewheel_s: float = 1.0,
        ppm: float = 0.0,
        keys: Path | None = None,
        is_real_time: bool = False,
        is_separate: bool = False,
        is_directed: bool = False,
    ) -> None:
        """`is_separate`: a sequence for each figure, planned alone, in place of one for all.

        `is_directed`: the stage has cues.
        """
        self.folder, self.seed, self.line = folder, seed, line
        self.names = [f"f{index}" for index in range(hosts)]
        self._tag = f"l{os.getpid() % 100000}"
        self._keys, self._ppm, self._is_real_time = keys, ppm, is_real_time
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._pool: subprocess.Popen[bytes] | None = None
        self._robots: dict[str, int] = {}
        self._rounds = 0
        self._proxy: subprocess.Popen[bytes] | None = None
        self._others, self._freewheel_s = others, freewheel_s
        self._is_separate, self.is_directed = is_separate, is_directed
        self._write(joints, show_s, loops)

    # ---- files

    def _write(self, joints: int, show_s: float, loops: int) -> None:
        folder = self.folder
        rows = "\n".join(f"  j{n}: {{id: {n + 1}, range_deg: [-90, 90]}}" for n in range(joints))
        (folder / "robot.yaml").write_text(ROBOT.format(name="figure", joints=rows))
        steps = round(show_s)
        # No two swings are the same, so that a move is known by its target.
        swings = [
            0 if index in (0, steps) else (30 + 11 * index % 17) * (-1) ** index
            for index in range(steps + 1)
        ]
        for name in self.names if self._is_separate else ("",):
            own = [f"j{n}" for n in range(joints)]
            every = own if name else [f"{one}.{joint}" for one in self.names for joint in own]
            keys = "\n".join(
                f"  - {{at_s: {index}, deg: {{{', '.join(f'{joint}: {deg}' for joint in every)}}}}}"
                for index, deg in enumerate(swings)
            )
            (folder / f"show{name}.yaml").write_text(
                f"sequence: show{name}\nrobot: robot.yaml\nloop: {loops}\nkeyframes:\n{keys}\n"
            )
        for name in self.names:
            self.write_stage(name, self._keys)
            (folder / f"{name}.jump").write_bytes(bytes(8))

    def write_stage(self, name: str, keys: Path | None) -> None:
        """Write the stage file of a host, with its folder of keys."""
        index = self.names.index(name)
        address = "10.77.0.1:7447" if index == 0 else f"10.77.0.254:{7000 + index}"
        own = {self.names[0]: f', address: "{address}"'}
        figures = "\n".join(
            f"  {one}: {{robot: robot.yaml{own.get(one, '')}}}" for one in self.names
        )
        cues = CUES if self.is_directed else ""
        network = f"freewheel_s: {self._freewheel_s}"
        if keys is not None:
            network += f", keys: {json.dumps(str(keys))}"
        each = ", ".join(f"{one}: show{one}.yaml" for one in self.names)
        shows = f"{{{each}}}" if self._is_separate else "show.yaml"
        (self.folder / f"{name}.yaml").write_text(
            f"stage: rig\nfigures:\n{figures}\nconductor: {self.names[0]}\n"
            f"shows: {{show: {shows}, more: {shows}}}\nnetwork: {{{network}}}\n"
            f"on_fault: {{others: {self._others}}}\n{cues}"
        )

    # ---- namespaces

    def __enter__(self) -> Self:
        try:
            self._make_network()
        except BaseException:
            self.remove()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.remove()

    def _make_network(self) -> None:
        switch = self.space("sw")
        _ip("netns", "add", switch)
        _ip("-n", switch, "link", "set", "lo", "up")
        _ip("-n", switch, "link", "add", "br0", "type", "bridge")
        _ip("-n", switch, "addr", "add", "10.77.0.254/24", "dev", "br0")
        _ip("-n", switch, "link", "set", "br0", "up")
        for index, name in enumerate(self.names):
            space, inner, outer = self.space(name), f"{self._tag}i{index}", f"{self._tag}o{index}"
            _ip("netns", "add", space)
            _ip("link", "add", inner, "type", "veth", "peer", "name", outer)
            _ip("link", "set", inner, "netns", space, "name", "eth0")
            _ip("link", "set", outer, "netns", switch, "name", f"p{index}")
            _ip("-n", switch, "link", "set", f"p{index}", "master", "br0", "up")
            _ip("-n", space, "addr", "add", f"10.77.0.{index + 1}/24", "dev", "eth0")
            _ip("-n", space, "link", "set", "lo", "up")
            _ip("-n", space, "link", "set", "eth0", "up")
        lines = [f"10.77.0.254:{7000 + k}=10.77.0.1:7447" for k in range(1, len(self.names))]
        self._proxy = subprocess.Popen(
            [
                *in_space(switch),
                sys.executable,
                "-m",
                "rig.proxy",
                str(self.seed),
                *self.line,
                *lines,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=rig_environment(),
        )
        assert self._proxy.stdout is not None
        assert self._proxy.stdout.readline() == b"ready\n"

    def space(self, name: str) -> str:
        """Return the namespace of a host."""
        return f"{self._tag}-{name}"

    # ---- hosts

    def start_all(self) -> None:
        """Start the robots, and every host."""
        self.start_robots()
        for name in self.names:
            self.start(name)

    @property
    def has_robots(self) -> bool:
        """Whether robots are there."""
        return bool(self._robots)

    def start_robots(self) -> None:
        """Start new robots, each behind the port of the last one."""
        if self._pool is None:
            self._pool = self._popen([sys.executable, "-m", "rig.robot"], "robots.txt")
        assert self._pool.stdin is not None
        self._rounds += 1
        for name in self.names:
            port, out = self.folder / f"{name}.port", self._verdict(name)
            words = [str(self.folder / "robot.yaml"), str(port), str(out)]
            self._pool.stdin.write(json.dumps(words).encode() + b"\n")
            self._pool.stdin.flush()
            _until(lambda port=port: port.exists(), 30.0, f"the robot of {name}")
            pid = out.with_suffix(".pid")
            _until(lambda pid=pid: pid.exists(), 30.0, f"the robot of {name}")
            self._robots[name] = int(pid.read_text())

    def _verdict(self, name: str) -> Path:
        return self.folder / f"{name}.{self._rounds}.json"

    def end_robots(self) -> dict[str, dict[str, Any]]:
        """End the robots when no player has their ports; return what the judge says of each."""
        for name, pid in self._robots.items():
            port = os.path.realpath(self.folder / f"{name}.port")
            _until(lambda port=port, pid=pid: not _users(port, pid), 40.0, f"{name}: port in use")
        for pid in self._robots.values():
            os.kill(pid, signal.SIGTERM)
        self._robots.clear()
        verdicts = {}
        for name in self.names:
            out = self._verdict(name)
            _until(lambda out=out: out.exists(), 60.0, f"the verdict about {name}")
            verdicts[name] = json.loads(out.read_text())
        return verdicts

    def start(self, name: str) -> None:
        """Start a host, or start it again."""
        if name in self._processes and (stdin := self._processes[name].stdin) is not None:
            with contextlib.suppress(OSError):
                stdin.close()
        index = self.names.index(name)
        ppm = self._ppm * (index % 3 - 1)
        clock = f"{index * 10**12},{ppm},{self.folder / f'{name}.jump'}"
        stores = [str(self.folder / f"{name}.{end}") for end in ("store", "port")]
        stage = str(self.folder / f"{name}.yaml")
        more = ["--real-time"] if self._is_real_time else []
        self._processes[name] = self._popen(
            [
                *in_space(self.space(name)),
                *[sys.executable, "-m", "rig.serve", stage, name, *stores, *more],
            ],
            f"{name}.txt",
            {"LSS_RIG_CLOCK": clock},
        )

    def jump(self, name: str, by_ns: int) -> None:
        """Let the clock of a host jump, that of its player too."""
        with (self.folder / f"{name}.jump").open("r+b") as file:
            (before,) = struct.unpack("<q", file.read(8))
            file.seek(0)
            file.write(struct.pack("<q", before + by_ns))

    def _popen(
        self, words: list[str], log: str, environment: dict[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        with (self.folder / log).open("ab") as file:
            return subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**rig_environment(), **(environment or {})},
                start_new_session=True,
            )

    def say(self, name: str, line: str) -> None:
        """Type a line at a host."""
        stdin = self._processes[name].stdin
        assert stdin is not None
        with contextlib.suppress(BrokenPipeError):
            stdin.write(f"{line}\n".encode())
            stdin.flush()

    def go(self, seconds: float = 180.0) -> None:
        """Say GO until all figures are ready, as a person would; return when they play.

        On a busy computer their clocks may not be known well enough at first.
        """
        end = time.monotonic() + seconds
        while "GO: the robots move" not in self.log(self.names[0]):
            self.say(self.names[0], "g")
            time.sleep(1.0)
            if time.monotonic() > end:
                raise TimeoutError(f"no GO within {seconds:g} s:\n{self.log(self.names[0])}")
        self.wait(self.names[0], "armed -> playing", seconds)

    def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """Send a signal to the process that serves a host, not to its player.

        One that ends it is waited for: its address is in use until then.
        """
        self._processes[name].send_signal(number)
        if number in (signal.SIGKILL, signal.SIGTERM):
            self._processes[name].wait(30)

    def cut(self, name: str) -> None:
        """Cut the cable of a host."""
        _ip("-n", self.space(name), "link", "set", "eth0", "down")

    def heal(self, name: str) -> None:
        """Mend it."""
        _ip("-n", self.space(name), "link", "set", "eth0", "up")

    @contextlib.contextmanager
    def storm(self, name: str, seed: int) -> Iterator[None]:
        """Let a program on the computer of a host send garbage meanwhile."""
        address = f"10.77.0.254:{7000 + self.names.index(name)}"
        words = [sys.executable, "-m", "rig.storm", "rig", name, address, str(seed)]
        process = subprocess.Popen(
            [*in_space(self.space(name)), *words], stdin=subprocess.PIPE, env=rig_environment()
        )
        try:
            yield
        finally:
            process.kill()
            process.wait(10)
            assert process.stdin is not None
            process.stdin.close()

    def log(self, name: str) -> str:
        """Return what a host has logged so far."""
        path = self.folder / f"{name}.txt"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""

    def wait(self, name: str, text: str, seconds: float, after: int = 0) -> int:
        """Wait until a host has logged `text` after so many characters; return where."""
        found = -1

        def is_there() -> bool:
            nonlocal found
            found = self.log(name).find(text, after)
            return found >= 0

        _until(is_there, seconds, f"{name}: {text!r} in\n{self.log(name)[-2000:]}")
        return found + len(text)

    def states(self) -> dict[str, str]:
        """Return the states of all figures as the conductor knows them."""
        first = self.names[0]
        mark = len(self.log(first))
        self.say(first, "?")
        pattern = re.compile(rf" {first}: (\w+): (not connected|\w+)")

        def found() -> dict[str, str]:
            return {m[1]: m[2] for m in pattern.finditer(self.log(first), mark)}

        with contextlib.suppress(TimeoutError):
            _until(lambda: len(found()) == len(self.names), 5.0, "states")
        return found()

    # ---- the end

    def end(self) -> dict[str, dict[str, Any]]:
        """End all hosts, then their robots; return what the judge says of each."""
        for name, process in self._processes.items():
            with contextlib.suppress(OSError, subprocess.CalledProcessError):
                self.heal(name)
            if process.poll() is None:
                self.say(name, "q")
        for process in self._processes.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(30)
        return self.end_robots()

    def remove(self) -> None:
        """End what is left, and remove the namespaces."""
        for pid in self._robots.values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        own = [one for one in (self._pool, self._proxy) if one is not None]
        for process in [*self._processes.values(), *own]:
            process.kill()
            process.wait(10)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
        for name in (*self.names, "sw"):
            subprocess.run(
                ["ip", "netns", "del", self.space(name)], capture_output=True, check=False
            )


def _users(port: str, robot: int) -> bool:
    """Return whether a process other than its robot has a port open."""
    for fd in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if str(fd.readlink()) == port and int(fd.parts[2]) != robot:
                return True
    return False


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def in_space(space: str) -> list[str]:
    """Return what begins a command in a namespace."""
    return ["ip", "netns", "exec", space]


def rig_environment() -> dict[str, str]:
    """Return the environment of the programs of a rig."""
    paths = [str(TOOLS / "rig" / "shim"), str(TOOLS), str(TOOLS.parent)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def _until(is_true: Any, seconds: float, what: str) -> None:  # noqa: ANN401
    end = time.monotonic() + seconds
    while not is_true():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:g} s: {what}")
        time.sleep(0.05)
