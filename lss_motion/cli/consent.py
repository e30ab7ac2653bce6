"""Whether a show may call its Python functions: asked once for each file and its content.

A show comes from anywhere, and a function can do whatever its user can. So a person sees which
functions of which files would run, and agrees, before any of them is imported. The answer is kept
in the user's state folder with a hash of the show, of the functions that it calls and of the bytes
of their modules; a change of any of them asks again. No other bytes are imported then.
"""

from __future__ import annotations

import hashlib
import json
import sys
from typing import TYPE_CHECKING, Final

from lss_motion.cli.messages import agrees, put
from lss_motion.errors import InputError
from lss_motion.files.output import state_directory, write_output
from lss_motion.files.source import read_data
from lss_motion.files.texts import counted
from lss_motion.show.functions import calls_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lss_motion.show.functions import Call, ModuleSource
    from lss_motion.show.model import Cue


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

    calls = calls_of(cues)
    modules = tuple(
        {(one.folder, one.name): one for call in calls for one in call.modules}.values()
    )
    if not calls or is_allowed:
        return modules
    digest = _digest(path, calls)
    if digest in _kept():
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


def _digest(path: Path, calls: Sequence[Call]) -> str:
    """Return the hash of the show, of the names of its functions, and of their modules."""
    digest = hashlib.sha256(json.dumps([str(path.resolve())]).encode())
    installed = {call.installed for call in calls if call.installed}
    contents = {str(file): read_data(file) for file in {path.resolve(), *installed}}
    contents |= {source.path: source.data for call in calls for source in call.modules}
    digest.update(json.dumps(sorted(call.run for call in calls)).encode())
    for name, data in sorted(contents.items()):
        digest.update(json.dumps([name, hashlib.sha256(data).hexdigest()]).encode())
    return digest.hexdigest()


def _kept() -> dict[str, str]:
    """Return the shows that were allowed, by hash; what cannot be read was not allowed."""
    try:
        kept = json.loads(read_data(state_directory() / FILE_NAME))
    except (InputError, ValueError, RecursionError):
        return {}
    return kept if isinstance(kept, dict) else {}


def _keep(path: Path, digest: str) -> None:
    kept = {**_kept(), digest: str(path.resolve())}
    newest = dict(list(kept.items())[-KEPT_MAX:])
    file = state_directory() / FILE_NAME
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_output(file, json.dumps(newest, indent=1) + "\n")
    except (InputError, OSError) as error:
        put(f"warning: the answer cannot be kept, so it is asked again: {error}", sys.stderr)
