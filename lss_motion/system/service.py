"""systemd: the unit that starts a stage with the computer, and what a running stage tells it.

`unit_text` is pure. `Notifier` sends the states of sd_notify(3) to the socket that systemd names in
the environment; without one it does nothing.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from typing import TYPE_CHECKING, Final, Self

from msgspec import Struct

from lss_motion.system.real_time import PRIORITY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

MARK: Final = "# Written by `lss-motion install-service`; `--remove` takes it away again."
WATCHDOG_S: Final = 30
"""A stage that tells nothing for so long is started again. Chosen: ten of its silent seconds after
which a player counts its server as lost."""
STOP_S: Final = 60
"""A show that is stopped has ended by then: it brakes, settles and gives back the settings."""
START_S: Final = 300
"""Planning all shows for the first time takes minutes on a small computer."""
RESTART_S: Final = 5


class ServiceUnit(Struct, frozen=True, kw_only=True):
    """What the unit of one stage holds."""

    stage: str
    command: Sequence[str]
    folder: Path
    user: str
    groups: Sequence[str]
    """Groups of ports, sound and pins that the user may lack."""
    is_networked: bool
    """Whether the stage listens on an address that the network gives to this computer."""
    variables: Mapping[str, str]


def unit_text(unit: ServiceUnit) -> str:
    """Return the unit as systemd reads it, with a reason beside each line that is not obvious."""
    network = (
        ["Wants=network-online.target", "After=network-online.target"] if unit.is_networked else []
    )
    groups = [f"SupplementaryGroups={' '.join(unit.groups)}"] if unit.groups else []
    variables = [
        f"Environment={quoted(f'{name}={value}')}" for name, value in unit.variables.items()
    ]
    lines = [
        MARK,
        "[Unit]",
        f"Description=lss_motion: stage {_plain(unit.stage)}",
        "After=network.target sound.target",
        *network,
        "# It is started again however often it ends.",
        "StartLimitIntervalSec=0",
        "",
        "[Service]",
        f"ExecStart={' '.join(quoted(word) for word in unit.command)}",
        f"WorkingDirectory={_plain(str(unit.folder))}",
        f"User={unit.user}",
        "# The serial port, the sound device and the pins belong to these groups.",
        *groups,
        *variables,
        "# The stage tells when it serves, and every few seconds that it and its player live.",
        "Type=notify",
        f"TimeoutStartSec={START_S}",
        f"WatchdogSec={WATCHDOG_S}",
        "# SIGTERM lets the player brake and hold; the default of the watchdog would kill it.",
        "WatchdogSignal=SIGTERM",
        "KillMode=control-group",
        f"TimeoutStopSec={STOP_S}",
        "Restart=on-failure",
        f"RestartSec={RESTART_S}",
        "# Files that must be changed (exit code 2) are not changed by trying again.",
        "RestartPreventExitStatus=2",
        "# The player runs before other programs and is not swapped out.",
        f"LimitRTPRIO={PRIORITY}",
        "LimitMEMLOCK=infinity",
        "OOMScoreAdjust=-500",
        "NoNewPrivileges=yes",
        "ProtectSystem=full",
        "",
        "[Install]",
        "WantedBy=multi-user.target",
    ]
    return "\n".join(lines) + "\n"


def quoted(word: str) -> str:
    """Return a word of a command as a unit has it (systemd.service(5), systemd.syntax(7))."""
    if any(ord(char) < 0x20 for char in word):
        raise ValueError(f"{word!r} holds a control character, which a unit cannot have")
    safe = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return safe if safe and not set(safe) & set(" \t'\";#\\") else f'"{safe}"'


def _plain(text: str) -> str:
    """Return text for a line that takes the rest as it stands."""
    return "".join(char if ord(char) >= 0x20 else " " for char in text).replace("%", "%%")


class Notifier:
    """Tells systemd how the program is."""

    def __init__(self, address: str | None, watchdog_s: float | None) -> None:
        self.watchdog_s = watchdog_s
        """Within this time it must get a message of the program; None: it does not watch."""
        self._address = address
        self._beat_s = 0.0
        self._status = ""

    @classmethod
    def from_environment(cls) -> Self:
        """Return the notifier for the socket of this process, and hide that from its children."""
        address = os.environ.pop("NOTIFY_SOCKET", None)
        watchdog_us = os.environ.pop("WATCHDOG_USEC", "")
        watched = os.environ.pop("WATCHDOG_PID", str(os.getpid()))
        is_watched = watchdog_us.isascii() and watchdog_us.isdigit() and watched == str(os.getpid())
        return cls(address, int(watchdog_us) / 1e6 if is_watched else None)

    def ready(self) -> None:
        """Tell that the program serves."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Tell what `systemctl status` shows."""
        if text != self._status:
            self._status = text
            self._send(f"STATUS={' '.join(text.split())}")

    def beat(self) -> None:
        """Tell that the program lives, four times within the time of the watchdog."""
        now_s = time.monotonic()
        if self.watchdog_s is not None and now_s >= self._beat_s:
            self._beat_s = now_s + self.watchdog_s / 4
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Tell that the program ends."""
        self._send("STOPPING=1")

    def _send(self, state: str) -> None:
        if not self._address:
            return
        # A name that begins with @ is one of Linux's abstract sockets.
        address = f"\0{self._address[1:]}" if self._address[0] == "@" else self._address
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
            own.setblocking(False)  # noqa: FBT003
            own.sendto(state.encode(), address)
