"""Shows on disk: a show whose files are unchanged is loaded, not read, planned and compiled again.

The name of an entry is a hash of the command line and the folder where it was given. An entry holds
the states of all files that the show was made of (`files.source`) and the show. It counts
(`planning.kept`) only if every file is what it was, and the bytes of its program pass the verifier
again, on its robot. What does not depend on files alone is never kept: limits that were asked of
servos, and functions of a show, which Python may find elsewhere the next time.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.files.cache import SHOW_SUFFIX
from lss_motion.files.source import are_unchanged, bounded_data, recorded
from lss_motion.planning.kept import MissError, keep, loaded
from lss_motion.planning.shows import recheck

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.shows import Show


def cached(given: tuple[object, ...], make: Callable[[], Show]) -> Show:
    """Return what `make` returns, if possible from an entry.

    `given` is all that decides about the show beside its files: the words of the command line.
    """
    try:
        name = hashlib.sha256(repr((Path.cwd(), given)).encode()).hexdigest()
    except OSError:  # The folder was removed.
        return make()
    with suppress(MissError):
        return loaded(SHOW_SUFFIX, name, _check)[1]
    with recorded() as record:
        show = make()
    if record.is_repeatable and not show.robot.read_limits:
        keep(SHOW_SUFFIX, name, (record.states, show))
    return show


def _check(entry: tuple[dict[str, str], Show]) -> None:
    states, show = entry
    if not are_unchanged(states, bounded_data):
        raise MissError
    recheck(show)
