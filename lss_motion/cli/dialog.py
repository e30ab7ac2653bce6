"""What a person reads and answers in a run: a line an event, and the question before the motion.

A real robot moves only after a person has agreed, or with `--yes`.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.messages import agrees, put
from lss_motion.errors import InputError
from lss_motion.files.cache import mark_of
from lss_motion.files.output import state_directory, write_output
from lss_motion.files.source import read_data
from lss_motion.files.texts import SCREEN_CHARS, aligned, counted
from lss_motion.playing.player.events import (
    Checked,
    CueReached,
    Faulted,
    MarkPassed,
    Noted,
    Phase,
    PhaseEntered,
    PlayerRequest,
    Waited,
    Warned,
)
from lss_motion.show.functions import calls_of, modules_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from lss_motion.cli.terminal import Inputs
    from lss_motion.playing.player.events import CheckedServo, Event
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.runner import Controls
    from lss_motion.robot.model import Robot
    from lss_motion.show.functions import Call, ModuleSource
    from lss_motion.show.model import Cue

YES_KEYS: Final = "yY"
NO_KEYS: Final = "nNqQ\r\n\x1b\x03\x04"
"""Enter alone means no, as the question shows."""
CAREFUL_KEYS: Final = "cC"
NUMBER_COLUMNS: Final = (1, 3, 5, 6, 7, 8, 9, 10)
"""The columns of numbers in the table of servos."""
SPARE_COLUMNS: Final = (3, 10, 9, 7, 2, 8, 4)
"""What is left out where the table is too wide: firmware, limits, supply, model, heat, status."""
WAIT_TEXTS: Final = {
    "begun": "        waiting for {}",
    "met": "        {}: going on",
    "timeout": "warning: no {} in time; going on",
}


def must_ask(arguments: argparse.Namespace, robot: Robot) -> bool:
    """Return whether a person must agree: true for a real robot, unless `--yes` is given.

    A pseudo-terminal counts as real, because the program behind it is unknown. Raises `InputError`
    if a person must agree and there is no terminal to answer on.
    """
    from lss_motion.cli.terminal import is_at_keyboard
    from lss_motion.playing.connection import is_simulated

    if arguments.yes or is_simulated(robot):
        return False
    if not is_at_keyboard():
        raise InputError(
            "a real robot would move, and there is no terminal to agree on: nothing was sent. "
            "Run it in a terminal, or add --yes to move without the question"
        )
    return True


def simulated_text(name: str, robot: Robot, how: str = "") -> str:
    """Return the line that tells that no real robot moves."""
    return f"{name}: no hardware, the robot {robot.name!r} is simulated{how}"


class Confirmation:
    """Controls that ask `go? [y/N]` once the robot has been checked, and then pass on to `inner`.

    `note` receives the answer and its instant. With `offer`, a text, the key `c` is an answer, too:
    nothing moves, and `is_careful` is set.
    """

    def __init__(
        self,
        inner: Controls[Player],
        inputs: Inputs,
        robot_name: str,
        note: Callable[[PlayerRequest, int], None] | None = None,
        *,
        offer: str = "",
    ) -> None:
        self.is_careful = False
        self._offer = offer
        self._inner = inner
        self._inputs = inputs
        self._robot_name = robot_name
        self._note = note
        self._is_asking = False

    def filenos(self) -> Sequence[int]:
        return (self._inputs if self._is_asking else self._inner).filenos()

    def act(self, driven: Player, now_ns: int) -> None:
        """Ask when the robot is ready; apply the answer."""
        if driven.phase is not Phase.READY:
            self._is_asking = False
            self._inner.act(driven, now_ns)
            return
        if not self._is_asking:
            self._is_asking = True
            _print(self._offer)
            _print(f"the robot {self._robot_name!r} will move: go? [y/N] ")
        signals_count, keys = self._inputs.take()
        known = YES_KEYS + NO_KEYS + (CAREFUL_KEYS if self._offer else "")
        answer = next((key for key in keys if key in known), "")
        is_no = signals_count or not self._inputs.has_keys or (answer and answer in NO_KEYS)
        if is_no or (answer and answer in CAREFUL_KEYS):
            self.is_careful = not is_no
            _print("no: nothing was moved\n" if is_no else "a careful run first\n")
            if self._note is not None:
                self._note(PlayerRequest("stop"), now_ns)
            driven.stop(now_ns)
        elif answer:
            _print("yes\n")
            if self._note is not None:
                self._note(PlayerRequest("go"), now_ns)
            driven.go()


def _print(text: str) -> None:
    put(text, sys.stderr, end="")


def print_event(
    event: Event, print_line: Callable[[str], None], *, is_verbose: bool = False
) -> None:
    """Print an event as one line; the result of the check as a table of the servos."""
    match event:
        case PhaseEntered(phase):
            print_line(f"        {phase.value}")
        case Checked(servos, notes):
            table = servo_table(servos, is_whole=is_verbose)
            print_line("\n".join([*table, *(f"note: {note}" for note in notes)]))
        case MarkPassed(label, show_s) if label:
            print_line(f"{show_s:7.2f} s {label}")
        case CueReached(cue, show_s):
            print_line(f"{show_s:7.2f} s {_cue_text(cue)}")
        case Waited(text, state):
            print_line(WAIT_TEXTS[state].format(text))
        case Noted(text):
            print_line(f"        {text}")
        case Warned(text):
            print_line(f"warning: {text}")
        case Faulted(step=step):
            print_line(f"fault: {event} ({step})")
        case _:
            pass


def _cue_text(cue: Cue) -> str:
    if cue.say:
        return f'"{cue.say}"'
    if cue.led:
        from lss_motion.protocol.constants import Led

        return "led " + ", ".join(f"{name} {Led(code).name.lower()}" for name, code in cue.led)
    return f"run {cue.run}" if cue.run else f"sound {Path(cue.sound).name}"


def servo_table(servos: Sequence[CheckedServo], *, is_whole: bool = False) -> list[str]:
    """Return a table of the checked servos, one line each. An unknown value is a dash.

    It fits a terminal of 80 characters; `is_whole`: it has every column.
    """
    head = ("joint", "id", "model", "fw", "status", "at", "start", "V", "°C", "deg/s",
            "deg/s²")  # fmt: skip
    rows = [head, *map(_row, servos)]
    if is_whole:
        return aligned(rows, right=NUMBER_COLUMNS)
    return aligned(rows, right=NUMBER_COLUMNS, spare=SPARE_COLUMNS, most_chars=SCREEN_CHARS)


def _row(found: CheckedServo) -> tuple[str, ...]:
    return (
        found.joint,
        str(found.servo_id),
        found.model or "-",
        "-" if found.firmware is None else str(found.firmware),
        found.status or "-",
        f"{found.position_deg:z.1f}",
        f"{found.start_deg - found.position_deg:+z.1f}",
        _number(found.voltage_v, 1),
        _number(found.temperature_c, 0),
        _number(found.speed_max_deg_s, 0),
        _number(found.accel_max_deg_s2, 0),
    )


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


FILE_NAME: Final = "allowed_functions.json"

KEPT_MAX: Final = 1000
"""Answers that are kept, the newest. Chosen: years of shows."""


def agreed_modules(
    path: Path, cues: Sequence[Cue], *, is_allowed: bool
) -> tuple[ModuleSource, ...] | None:
    """Return the modules of the show at `path` that may be run; ask if it is not known. None: no.

    Raises `InputError` where a person must be asked, and there is no terminal to answer on.
    """
    from lss_motion.cli.terminal import is_at_keyboard

    calls, modules = calls_of(cues), modules_of(cues)
    if not calls or is_allowed:
        return modules
    digest = _digest(path, calls)
    mark = mark_of([digest])
    if mark is not None and mark.hex() in _kept():
        return modules
    if not is_at_keyboard():
        raise InputError(
            f"calls {counted(calls, 'Python function')} on this computer "
            f"({', '.join(call.run for call in calls)}), and there is no terminal to agree on: "
            "nothing was played. Read them, then run it in a terminal, or add --allow-run",
            path=path,
        )
    put(f"{path} runs Python on this computer, with all that you may do:", sys.stderr)
    for call in calls:
        put(f"  {call.text}", sys.stderr)
    if not agrees("allow it, until a file of these changes?", sys.stderr):
        return None
    _keep(path, digest)
    return modules


def _digest(path: Path, calls: Sequence[Call]) -> bytes:
    """Return the hash of the show, of the names of its functions, and of their modules."""
    digest = hashlib.sha256(json.dumps([str(path.resolve())]).encode())
    installed = {call.installed for call in calls if call.installed}
    contents = {str(file): read_data(file) for file in {path.resolve(), *installed}}
    contents |= {source.path: source.data for call in calls for source in call.modules}
    digest.update(json.dumps(sorted(call.run for call in calls)).encode())
    for name, data in sorted(contents.items()):
        digest.update(json.dumps([name, hashlib.sha256(data).hexdigest()]).encode())
    return digest.digest()


def _kept() -> dict[str, str]:
    """Return the shows that were allowed, by the mark of this user for their hash.

    What cannot be read was not allowed; no other user can write a mark.
    """
    try:
        kept = json.loads(read_data(state_directory() / FILE_NAME))
    except (InputError, ValueError, RecursionError):
        return {}
    return kept if isinstance(kept, dict) else {}


def _keep(path: Path, digest: bytes) -> None:
    file = state_directory() / FILE_NAME
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        mark = mark_of([digest], may_make_key=True) or b""
        newest = dict(list({**_kept(), mark.hex(): str(path.resolve())}.items())[-KEPT_MAX:])
        write_output(file, json.dumps(newest, indent=1) + "\n")
    except (InputError, OSError) as error:
        put(f"warning: the answer cannot be kept, so it is asked again: {error}", sys.stderr)
