"""What an adapter returns of what was sent to it: one wire for both ways, or TX and RX joined.

A servo never sends `#`, and commands of other hosts are not seen (FACTS.md W2). So a line that
comes back as it was sent is an echo. `EchoFilter` takes it out, whatever answers come besides.
"""

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError

if TYPE_CHECKING:
    from collections.abc import Container, Mapping

    from lss_motion.robot.model import Bus

SENT_MAX: Final = 256
"""Lines that are remembered. Chosen: a roll call of all ids, whose echo an adapter holds back."""
_LINE: Final = re.compile(rb"#[^#*\r]*\r")


class EchoFilter:
    """Takes the echo out of what arrives on one line."""

    def __init__(self) -> None:
        self.count = 0
        """Lines that came back."""
        self._sent: deque[bytes] = deque(maxlen=SENT_MAX)
        self._held = b""
        self._is_between = True
        """Whether the last byte that was passed on ended a line."""

    def note_sent(self, data: bytes) -> None:
        """Note bytes that leave: whole lines."""
        self._sent.append(data)

    def without_echo(self, data: bytes) -> bytes:
        """Return what has arrived without what came back. The begin of an echo is held."""
        if b"#" not in data and not self._held and not data.startswith(b"\r"):
            return self._passed(data)
        data, self._held = self._held + data, b""
        data = _LINE.sub(self._replaced, data)
        begin = data.rfind(b"#")
        if begin >= 0 and b"\r" not in data[begin:] and self._is_sent(data[begin:]):
            data, self._held = data[:begin], data[begin:]
        if self._is_between and b"\r" in self._sent:
            data = data.lstrip(b"\r")
        return self._passed(data)

    def _passed(self, data: bytes) -> bytes:
        if data:
            self._is_between = data.endswith(b"\r")
        return data

    def _replaced(self, line: re.Match[bytes]) -> bytes:
        if not self._is_sent(line[0]):
            return line[0]
        self.count += 1
        return b""

    def _is_sent(self, line: bytes) -> bool:
        return any(line in sent for sent in self._sent)


def echo_text(port: str, *, is_alone: bool) -> str:
    """Return the text about a port that returns what is sent to it; `is_alone`: nothing else."""
    if is_alone:
        return (
            f"port {port} returns what is sent, and nothing else: no servo answers. Its adapter "
            f"echoes, or its TX and RX are joined, or another device is at this port. Check the "
            f"wires and the power of the servos"
        )
    return f"port {port} returns what is sent: its adapter echoes. The echo is left out"


def judge_echo(
    buses: Mapping[str, Bus], filters: Mapping[str, EchoFilter], answering: Container[str]
) -> list[str]:
    """Return a warning for each port that echoes; `answering`: the buses with answers.

    Raises `BusError` for a port that returns what is sent, and nothing else.
    """
    warnings = []
    for name in (name for name, echo in filters.items() if echo.count):
        port, is_alone = buses[name].port, name not in answering
        if is_alone:
            raise BusError(echo_text(port, is_alone=True), url=port)
        warnings.append(echo_text(port, is_alone=False))
    return warnings
