"""The line of a program's text form that says what the show waits for."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.sequence.model import Wait
from lss_motion.trajectory.model import WaitPoint
from lss_motion.units import s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Container

_NUMBER = r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)"
_WAIT: Final = re.compile(rf"(\d+) (\S+) (below|above) {_NUMBER}(?: timeout {_NUMBER})?")


def wait_line(point: WaitPoint) -> str:
    """Return `1750000 eye below 300 timeout 60`: when, what for, and how long at most."""
    wait = point.wait
    timeout = "" if wait.timeout_s is None else f" timeout {wait.timeout_s:.9g}"
    at_us = us_from_s(point.at_s)
    return f"{at_us} {wait.sensor} {wait.side} {wait.threshold:.9g}{timeout}"


def read_wait(text: str, sensors: Container[str]) -> WaitPoint:
    """Return what `wait_line` wrote. Raises `ValueError` with the reason for anything else."""
    match = _WAIT.fullmatch(text)
    if match is None:
        raise ValueError(
            f"{text!r} is not of the form `<us> <sensor> below|above <value> [timeout <s>]`"
        )
    if match[2] not in sensors:
        raise ValueError(f"the robot has no sensor {match[2]!r}")
    wait = Wait(
        sensor=match[2],
        side="below" if match[3] == "below" else "above",
        threshold=float(match[4]),
        timeout_s=None if match[5] is None else float(match[5]),
    )
    return WaitPoint(at_s=s_from_us(int(match[1])), wait=wait)
