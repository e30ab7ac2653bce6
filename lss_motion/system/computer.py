"""Checks of this computer: what each found, and what to do about it.

No check raises, and none opens a port: opening a port may restart the device on it.
"""

from __future__ import annotations

import os
import re
import sys
import time
from enum import StrEnum
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.system.clock import MonotonicClock
from lss_motion.system.devices import list_devices, permission_hint
from lss_motion.system.real_time import prompt_waits
from lss_motion.units import NS_PER_MS, NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LATENCY_MAX_MS: Final = 1
"""A longer timer delays every answer (FACTS.md H1)."""
RESOLUTION_MAX_NS: Final = 10 * NS_PER_US
"""A hundredth of the line time of a command at 115200 bps. Chosen."""
JITTER_WAIT_NS: Final = 2 * NS_PER_MS
JITTER_WAITS: Final = 250
"""Half a second in all, waited as the run loop waits."""
LATE_MAX_NS: Final = NS_PER_MS
"""The line time of a command at 115200 bps: later than that, it is late (FACTS.md W25)."""
PORT_GRABBERS: Final = {
    "ModemManager": "it opens new serial ports and sends to them for half a minute: "
    "`sudo systemctl disable --now ModemManager`, if there is no modem",
    "brltty": "it takes adapters with a CH340 for Braille displays: `sudo apt remove brltty`, if "
    "there is none",
}

_REQUIREMENT: Final = re.compile(r"([A-Za-z0-9._-]+)\s*(?:>=\s*([0-9.]+))?")


class Level(StrEnum):
    """How much a finding matters: playing works, works less well, or cannot work."""

    OK = "ok"
    HINT = "hint"
    BAD = "BAD"


class Finding(Struct, frozen=True, kw_only=True):
    """The result of one check. `fix` is empty where nothing has to be done."""

    subject: str
    level: Level
    text: str
    """The result; the name is the key in the JSON of `lss-motion doctor`."""
    fix: str = ""


def examine(root: Path = Path("/")) -> list[Finding]:
    """Run every check. `root` is the folder that holds /proc and /sys."""
    checks: Sequence[tuple[str, Callable[[], list[Finding]]]] = (
        ("Python", check_python),
        ("packages", check_packages),
        ("ports", check_ports),
        ("USB latency", lambda: check_latency(root)),
        ("other programs", lambda: check_grabbers(root)),
        ("clock", check_clock),
        ("timer", check_timer),
        ("CPU", lambda: check_governor(root)),
        ("simulated ports", check_terminals),
    )
    found = []
    for subject, check in checks:
        try:
            found += check()
        except Exception as error:  # noqa: BLE001 (one check must not end the others)
            text = f"could not be checked: {type(error).__name__}: {error}"
            found.append(Finding(subject=subject, level=Level.HINT, text=text))
    return found


def check_python() -> list[Finding]:
    """Name the running Python. An older one than required cannot start this code."""
    text = ".".join(map(str, sys.version_info[:3])) + f" at {sys.executable}"
    return [Finding(subject="Python", level=Level.OK, text=text)]


def check_packages(
    required: Sequence[str] | None = None, version_of: Callable[[str], str] = metadata.version
) -> list[Finding]:
    """Compare the installed packages with the required ones, extras excepted."""
    if required is None:
        try:
            required = metadata.requires("lss-motion") or []
        except metadata.PackageNotFoundError:
            fix = "run it through `tools/run`, or `pip install -e .` in its folder"
            text = "lss-motion itself is not installed"
            return [Finding(subject="packages", level=Level.BAD, text=text, fix=fix)]
    bad, count = [], 0
    for requirement in required:
        match = _REQUIREMENT.match(requirement)
        if match is None or "extra ==" in requirement:
            continue
        count += 1
        name, least = match[1], match[2] or "0"
        try:
            installed = version_of(name)
        except metadata.PackageNotFoundError:
            bad.append(f"{name} is missing")
            continue
        if _numbers(installed) < _numbers(least):
            bad.append(f"{name} {installed} is older than {least}")
    if bad:
        fix = "`pip install --upgrade lss-motion`, or delete .venv and let `tools/run` rebuild it"
        return [Finding(subject="packages", level=Level.BAD, text=", ".join(bad), fix=fix)]
    return [Finding(subject="packages", level=Level.OK, text=f"all {count} are there")]


def check_ports() -> list[Finding]:
    """List the USB serial ports, and name those that this user may not open."""
    found = []
    for device in list_devices():
        if not device.is_usb:
            continue
        text = f"{device.path}, {device.name}"
        if os.name != "posix" or os.access(device.path, os.R_OK | os.W_OK):
            found.append(Finding(subject="port", level=Level.OK, text=text))
        else:
            fix = permission_hint(device.path)
            found.append(Finding(subject="port", level=Level.BAD, text=text, fix=fix))
    if found:
        return found
    fix = "plug the adapter in; a port that is not on USB needs none of this"
    return [Finding(subject="ports", level=Level.HINT, text="none on USB", fix=fix)]


def check_latency(root: Path) -> list[Finding]:
    """Read the latency timers of FTDI adapters (Linux)."""
    timers = sorted((root / "sys/bus/usb-serial/devices").glob("*/latency_timer"))
    found = []
    for timer in timers:
        wait_ms = int(timer.read_text(encoding="ascii"))
        text = f"/dev/{timer.parent.name}: {wait_ms} ms"
        if wait_ms <= LATENCY_MAX_MS:
            found.append(Finding(subject="USB latency", level=Level.OK, text=text))
            continue
        fix = (
            f"lss_motion requests 1 ms when it opens the port; where that is refused: "
            f"`echo 1 | sudo tee {timer}`"
        )
        found.append(Finding(subject="USB latency", level=Level.HINT, text=text, fix=fix))
    return found


def check_grabbers(root: Path) -> list[Finding]:
    """Look for programs that are known to open any serial port (Linux)."""
    running = set()
    for comm in (root / "proc").glob("[0-9]*/comm"):
        try:
            running.add(comm.read_text(encoding="utf-8", errors="replace").strip())
        except OSError:  # The process has ended in the meantime.
            continue
    return [
        Finding(subject="other programs", level=Level.HINT, text=f"{name} is running", fix=fix)
        for name, fix in PORT_GRABBERS.items()
        if name in running
    ]


def check_clock(resolution_ns: int | None = None) -> list[Finding]:
    """Measure the smallest step of the clock that times the commands."""
    if resolution_ns is None:
        resolution_ns = _smallest_step_ns()
    text = f"steps of {resolution_ns} ns"
    if resolution_ns <= RESOLUTION_MAX_NS:
        return [Finding(subject="clock", level=Level.OK, text=text)]
    fix = (
        "commands leave as late as one such step; another system or a real machine has a finer one"
    )
    return [Finding(subject="clock", level=Level.HINT, text=text, fix=fix)]


def check_timer(lates_ns: Sequence[int] | None = None) -> list[Finding]:
    """Measure how late this computer wakes up from a wait of the run loop."""
    lates = sorted(_measure_lates_ns() if lates_ns is None else lates_ns)
    usual_us = lates[len(lates) // 2] // NS_PER_US
    worst_ns = lates[int(0.99 * (len(lates) - 1))]
    text = (
        f"wakes {usual_us} us late as a rule, {worst_ns // NS_PER_US} us in one of a hundred, "
        f"{lates[-1] // NS_PER_US} us at worst"
    )
    if worst_ns <= LATE_MAX_NS:
        return [Finding(subject="timer", level=Level.OK, text=text)]
    fix = (
        "end programs that keep the computer busy; on Linux `lss-play --real-time` gives the "
        "player priority; a virtual machine or a laptop on battery may stay late"
    )
    return [Finding(subject="timer", level=Level.HINT, text=text, fix=fix)]


def check_governor(root: Path) -> list[Finding]:
    """Report a CPU that saves power (Linux); it wakes up later."""
    path = root / "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"
    if not path.exists():
        return []
    governor = path.read_text(encoding="ascii").strip()
    if governor != "powersave":
        return [Finding(subject="CPU", level=Level.OK, text=f"governor {governor}")]
    fix = "if the timer is late: `sudo cpupower frequency-set -g performance`"
    return [Finding(subject="CPU", level=Level.HINT, text=f"governor {governor}", fix=fix)]


def check_terminals() -> list[Finding]:
    """Report whether `lss-motion sim` can work here."""
    try:
        for descriptor in os.openpty():
            os.close(descriptor)
    except (AttributeError, OSError):
        fix = "`lss-motion sim` does not work here; sim:// in process does"
        text = "this system has no pseudo-terminals"
        return [Finding(subject="simulated ports", level=Level.HINT, text=text, fix=fix)]
    return [Finding(subject="simulated ports", level=Level.OK, text="pseudo-terminals work")]


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"[0-9]+", version)[:3])


def _smallest_step_ns() -> int:
    steps: list[int] = []
    last_ns = time.monotonic_ns()
    while len(steps) < 100:
        now_ns = time.monotonic_ns()
        if now_ns != last_ns:
            steps.append(now_ns - last_ns)
            last_ns = now_ns
    return min(steps)


def _measure_lates_ns() -> list[int]:
    clock = MonotonicClock()
    lates_ns = []
    with prompt_waits():
        for _ in range(JITTER_WAITS):
            due_ns = clock.now_ns() + JITTER_WAIT_NS
            clock.wait_until(due_ns)
            lates_ns.append(max(clock.now_ns() - due_ns, 0))
    return lates_ns
