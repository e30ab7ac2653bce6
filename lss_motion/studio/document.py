"""The open file: its revision, what is wrong in it, and the last plan that is good.

A file that changes on disk, or one that it includes, is planned again. While it is planned, and
when it has an error, the last good plan stays: it can be seen and played.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.studio.planner import PlannerReply, Request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

VIEWS_MAX: Final = 3
"""Views of plans that are kept, the newest: clients may still fetch the one before."""
Stamp = tuple[int, int, int] | None


class Document:
    """One file and what was planned of it. `ask` starts planning; `changed` tells the clients."""

    def __init__(
        self,
        request: Request,
        ask: Callable[[Request], None],
        changed: Callable[[], None],
    ) -> None:
        self.folder = request.path.resolve().parent
        """Nothing outside of it is opened, or given to a client."""
        self.revision = 0
        self.good: PlannerReply | None = None
        """The last reply with a plan, or of a robot file without an error."""
        self.robot_revision = 0
        self.shown: str | None = None
        """The show of a stage whose plan clients see."""
        self._request = request
        self._ask, self._changed = ask, changed
        self._newest = PlannerReply(number=0, title=request.path.stem)
        self._views: dict[str, bytes] = {}
        self._stamps: dict[Path, Stamp] = {}
        self._is_planning = self._is_current = False
        self._asked_s = 0.0
        self._plan()

    @property
    def path(self) -> Path:
        return self._request.path

    @property
    def newest(self) -> PlannerReply:
        """The last reply, good or not."""
        return self._newest

    def load(self, name: str) -> None:
        """Open another file of the folder; raises `InputError` for one that is not there."""
        path = self.inside(name)
        if path.suffix.lower() not in (".yaml", ".yml") or _stamp(path) is None or path.is_dir():
            raise InputError("is no show, gait or robot (.yaml) in this folder", path=name)
        self._request = Request(
            number=0,
            path=self._request.path.parent / path.relative_to(self.folder),
            robot_path=self._request.robot_path,
            backup=self._request.backup,
            port=self._request.port,
            views=self._request.views,
            figure=self._request.figure,
        )
        self.good, self._views, self._stamps = None, {}, {}
        self._newest = PlannerReply(number=0, title=path.stem)
        self._plan()

    def inside(self, name: str) -> Path:
        """Return the path of a file below the folder; raises `InputError` if it is not below."""
        try:
            path = (self.folder / name).resolve()
        except (ValueError, OSError, RuntimeError):
            raise InputError("is no name of a file") from None
        if not path.is_relative_to(self.folder):
            raise InputError("is not in the folder of the show", path=name)
        return path

    def view(self, plan: str) -> bytes | None:
        """Return the view of a plan that is kept."""
        own, folder = self._views.get(plan), self._request.views
        if own is not None or folder is None or plan not in self._plans():
            return own
        try:
            return (folder / f"{plan}.json").read_bytes()
        except OSError:
            return None

    def take(self, reply: PlannerReply) -> None:
        """Take the reply to the newest request."""
        self._newest, self._is_planning = reply, False
        # What is wrong may be mended by another file: one that was included, or is not there yet.
        older = {self.folder: _stamp(self.folder), **self._stamps} if reply.problems else {}
        newer = {path: self._stamps.get(path, _stamp(path)) for path in reply.files}
        self._stamps = {**older, **newer}
        self._is_current = not reply.problems
        if reply.robot and (self.good is None or reply.robot != self.good.robot):
            self.robot_revision += 1
        if self._is_current:
            self.good = reply
        if reply.plan is not None and reply.stage is None:
            self._views.pop(reply.plan, None)
            self._views[reply.plan] = reply.view
            for old in list(self._views)[:-VIEWS_MAX]:
                del self._views[old]
        self._changed()

    @property
    def plan(self) -> str | None:
        """The plan that clients see: of the file, or of the present show of a stage."""
        if self.good is None or self.good.stage is None:
            return None if self.good is None else self.good.plan
        if not self.runs_stage:
            return None  # A server that does not run the stage keeps no views of its shows.
        stage, plans = self.good.stage, self.good.plans
        names = (self.shown, stage.idle, *plans)
        return next((plans[name] for name in names if name is not None and name in plans), None)

    @property
    def runs_stage(self) -> bool:
        """Whether the server runs a stage (`lss-motion serve`)."""
        return self._request.views is not None

    def _plans(self) -> frozenset[str]:
        return frozenset() if self.good is None else frozenset(self.good.plans.values())

    def look(self) -> None:
        """Look whether a file has changed on disk; plan again if one has."""
        if any(_stamp(path) != stamp for path, stamp in self._stamps.items()):
            self._plan()

    def is_made_of(self, path: Path) -> bool:
        """Return whether a file, by its full path, is one of those that were planned."""
        return path in {one.resolve() for one in self._stamps}

    def message(self) -> m.DocumentChanged:
        """Return the state as an event."""
        newest = self._newest
        return m.DocumentChanged(
            revision=self.revision,
            file=self.path.name,
            kind=newest.kind,
            title=newest.title,
            is_planning=self._is_planning,
            planning_s=time.monotonic() - self._asked_s if self._is_planning else 0.0,
            errors=tuple(
                m.Problem(path=self._shown(path), line=line, text=text)
                for path, line, text in newest.problems
            ),
            notes=newest.notes,
            plan=self.plan,
            is_current=self._is_current,
            has_planner=newest.has_planner,
            summary=() if self.good is None else self.good.summary,
            robot=self.robot_revision,
        )

    def _plan(self) -> None:
        """Plan the file as it is on disk now."""
        self.revision += 1
        self._is_planning, self._is_current = True, False
        self._asked_s = time.monotonic()
        self._stamps = {path: _stamp(path) for path in {*self._stamps, *self._first()}}
        self._ask(self._request)
        self._changed()

    def _first(self) -> Iterable[Path]:
        request = self._request
        return [p for p in (request.path, request.robot_path, request.backup) if p is not None]

    def _shown(self, path: str) -> str:
        """Return a path as people know it: from the folder of the show, if it is there."""
        full = Path(path).resolve()
        return str(full.relative_to(self.folder)) if full.is_relative_to(self.folder) else path


def _stamp(path: Path) -> Stamp:
    """Return what changes when a file does; None where there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
