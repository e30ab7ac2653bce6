"""Examine a whole stage before the doors open: `lss-motion doctor --stage STAGE.yaml`.

It is run on the conductor's computer, while the other figures are served. It asks every figure to
examine its own computer and servos (`lss-motion doctor ROBOT`), and compares versions, robot files
and clocks. Nothing moves. If the conductor is served, it is the one that asks (`Examining`), and
the doctor gets what it has found (`examined_by_conductor`).
"""

from __future__ import annotations

import contextlib
import json
import secrets
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from msgspec.structs import replace

from lss_motion.errors import BusError, InputError
from lss_motion.stage.hosts.clocks import REFUSE_NS, WARN_NS
from lss_motion.stage.hosts.messages import (
    Ask,
    Examine,
    Examined,
    FigureFinding,
    Findings,
    packed,
    parse,
)
from lss_motion.stage.hosts.plans import robot_hash
from lss_motion.units import NS_PER_MS, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.stage.hosts.conductor import Conductor
    from lss_motion.stage.hosts.figure import FollowingFigure
    from lss_motion.stage.hosts.peer import NetworkSettings
    from lss_motion.stage.hosts.remote_figures import RemoteFigure

WAIT_S: Final = 30.0
"""Figures that have not examined themselves by then are named as they are."""
DOCTOR_S: Final = 25.0
DONE_S: Final = 5.0
"""A conductor that is served has answered so long after it has given up a figure."""
DISK_MIN_BYTES: Final = 200_000_000
"""Chosen: a night of logs with their bound, and the plans of some shows."""
OWN: Final = "0" * 16
"""The question of the doctor itself: what is found is sent to no other process."""
TEXTS_MAX: Final = 30
"""Findings of one figure that are sent: what is bad first."""


class Examiner(Protocol):
    """What is needed of a `host.Host` that conducts."""

    conductor: Conductor | None
    figure: FollowingFigure
    findings: dict[str, Findings]

    def turn(self) -> None: ...


def examined(figure: str, number: int, robot: Robot, port: str | None, folder: Path) -> Findings:
    """Examine this computer and its servos, in a process of its own."""
    words = ["doctor", str(robot.path), "--json", *(["--port", port] if port else [])]
    program = "import sys; from lss_motion.cli.main import main; sys.exit(main(sys.argv[1:]))"
    found: list[FigureFinding] = []
    try:
        done = subprocess.run(  # noqa: S603  (our own program)
            [sys.executable, "-P", "-c", program, *words],
            capture_output=True,
            text=True,
            timeout=DOCTOR_S,
            check=False,
        )
        for one in json.loads(done.stdout)["findings"]:
            text = f"{one['text']}{'; ' if one['fix'] else ''}{one['fix']}"
            found.append(
                FigureFinding(level=str(one["level"]), subject=one["subject"][:64], text=text[:300])
            )
    except (OSError, ValueError, KeyError, subprocess.TimeoutExpired) as error:
        found.append(FigureFinding(level="bad", subject="doctor", text=str(error)[:300]))
    found.append(_disk(folder))
    order = {"bad": 0, "hint": 1}
    found.sort(key=lambda one: order.get(one.level.lower(), 2))
    return Findings(figure=figure, number=number, findings=tuple(found[:TEXTS_MAX]))


def _disk(folder: Path) -> FigureFinding:
    place = next((one for one in (folder, *folder.parents) if one.exists()), Path.cwd())
    free = shutil.disk_usage(place).free
    level = "ok" if free >= DISK_MIN_BYTES else "bad"
    return FigureFinding(level=level, subject="disk", text=f"{free / 1e9:.1f} GB free at {place}")


def examine_stage(
    host: Examiner, robots: Mapping[str, Robot], wait_s: float | None = None
) -> list[Examined]:
    """Let all figures examine themselves; return what was found, figure by figure.

    `host` is that of the conductor, which plays nothing meanwhile; `robots` are those of its files.
    """
    hashes = {name: robot_hash(robot) for name, robot in robots.items()}
    examining = Examining(host, OWN, time.monotonic_ns(), hashes, wait_s)
    while (found := examining.turn(time.monotonic_ns())) is None:
        host.turn()
    return found


class Examining:
    """An examination by the conductor; `turn` is called until it is done."""

    def __init__(
        self,
        host: Examiner,
        asked: str,
        now_ns: int,
        robots: Mapping[str, str] | None = None,
        wait_s: float | None = None,
    ) -> None:
        """`robots` are the hashes of those in the files here; else those of the show that is on."""
        conductor = host.conductor
        assert conductor is not None, "the conductor's computer examines"
        conductor.examines += 1
        self._host, self._conductor, self._asked = host, conductor, asked
        self._number = conductor.examines
        self._robots = robots
        self._end_ns = now_ns + ns_from_s(WAIT_S if wait_s is None else wait_s)

    def turn(self, now_ns: int) -> list[Examined] | None:
        """Return what was found about each figure; None: it is not done yet."""
        figures = self._conductor.figures
        if now_ns < self._end_ns and not all(
            self._is_done(one, now_ns) for one in figures.values()
        ):
            return None
        cast, robots = self._conductor.cast, self._robots
        if robots is None:
            robots = {} if cast is None else {name: one.robot for name, one in cast.parts.items()}
        found = []
        version = self._host.figure.version
        for name, figure in figures.items():
            rows = rows_of(figure, self._findings(name), version, robots.get(name))
            if figure.status is not None and figure.is_lost(now_ns):
                rows.insert(0, _found("bad", "network", "is lost: nothing arrives from it"))
            found.append(Examined(figure=name, asked=self._asked, rows=tuple(rows)))
        return found

    def _findings(self, name: str) -> Findings | None:
        found = self._host.findings.get(name)
        return None if found is None or found.number != self._number else found

    def _is_done(self, figure: RemoteFigure, now_ns: int) -> bool:
        """Return whether nothing more is to be expected: a figure that plays examines nothing."""
        status = figure.status
        if status is None or figure.is_lost(now_ns):
            return False
        return self._findings(figure.name) is not None and status.bound_ns is not None


def examined_by_conductor(settings: NetworkSettings, wait_s: float | None = None) -> list[Examined]:
    """Return what the conductor that is served on this computer finds about every figure.

    Raises `BusError` if it does not answer.
    """
    from lss_motion.stage.hosts.peer import Peer

    asked = secrets.token_hex(8)
    ask = Ask(operation=Examine(), number=1, instance=asked)
    found: dict[str, Examined] = {}
    end = time.monotonic() + (WAIT_S if wait_s is None else wait_s) + DONE_S
    asked_again = 0.0
    with Peer(replace(settings, is_visitor=True)) as peer:
        peer.subscribe("examined/*")
        while time.monotonic() < end and len(found) < len(settings.figures):
            if time.monotonic() > asked_again:
                asked_again = time.monotonic() + 1.0
                peer.send(f"figure/{settings.conductor}/ask", packed(ask))
            for arrival in peer.take(0.1):
                with contextlib.suppress(InputError):
                    one = parse(Examined, arrival.content)
                    if one.asked == asked:
                        found[one.figure] = one
    if not found:
        raise BusError(f"the conductor at {settings.address} does not answer")
    return [found[name] for name in settings.figures if name in found]


def rows_of(
    figure: RemoteFigure, findings: Findings | None, version: str, robot_hash: str | None
) -> list[FigureFinding]:
    """Return what is known of one figure, a line each."""
    status = figure.status
    if status is None:
        text = "does not answer: is it served there, are address, cable and keys right?"
        return [_found("bad", "network", text)]
    rows = [_found("ok", "network", f"answers in {_ms(status.round_trip_ns)} ms")]
    is_same = status.version == version
    text = status.version if is_same else f"{status.version}, here {version}: install the same"
    rows.append(_found("ok" if is_same else "bad", "version", text))
    is_same = robot_hash is None or status.robot == robot_hash
    text = status.robot[:8] if is_same else "differs from the file here: give both the same one"
    rows += [_found("ok" if is_same else "bad", "robot file", text), _clock_row(status.bound_ns)]
    if findings is None:
        return [*rows, _found("bad", "computer", "has not examined itself in time")]
    return rows + [_found(one.level.lower(), one.subject, one.text) for one in findings.findings]


def _found(level: str, subject: str, text: str) -> FigureFinding:
    return FigureFinding(level=level, subject=subject[:64], text=text[:300])


def _clock_row(bound_ns: int | None) -> FigureFinding:
    text = f"known to {_ms(bound_ns)} ms"
    if bound_ns is None:
        return _found("bad", "clock", "not known yet")
    if bound_ns > REFUSE_NS:
        return _found("bad", "clock", f"{text}: a start is refused")
    return _found("hint" if bound_ns > WARN_NS else "ok", "clock", text)


def _ms(span_ns: int | None) -> str:
    return "?" if span_ns is None else f"{span_ns / NS_PER_MS:.2f}"
