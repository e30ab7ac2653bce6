"""The open file: its text, its revision, what is wrong in it, and the last plan that is good.

Of a folder nothing is open until a client loads a file of it, or makes one.

A file that is edited or changes on disk, or one that it includes, is planned again. While it is
planned, and when it has an error, the last good plan stays: it can be seen and played.

**Edits** (`playing.remote.edit_messages`; who may edit needs no lease). Each operation names the
`revision` of the event `document` on which it was made; a stale one is refused, and nothing is
done. An accepted one makes the next revision: the event `document` comes first, then `accepted`, so
a client that waits for `accepted` knows the revision for its next edit.

    {"op": "key.move", "id": 7, "revision": 12, "by_s": 0.25, "ripple": false,
     "keys": [{"file": "wave.yaml", "place": ["keyframes", 3], "joints": ["wrist"]}]}

- A key is a keyframe by its `place` in its file: keys of the view have `file` (of their lane) and
  `place`. `joints` takes some of its joints only: moved in time, they get a keyframe of their own.
- `GET /model/REVISION.json` (role operate) is what the files hold now, without the plan: of each
  file its `value` (the YAML as JSON), for each list of keyframes its `place`, the `times_s` of its
  items and their `lines`; so the next edit need not wait for the planner.
- An operation is checked in full before anything changes: places and types, the text that is
  parsed again, the keys of the file, and `allowed`. What then cannot be planned is no refusal: it
  stands in `errors`, and `is_current` is false. That is also so while it is planned: the plan is a
  draft until `is_current` is true.
- `editing` of the event `document`: `undo` and `redo` (what they would do, or null), `unsaved`
  files, `conflicts` with the disk, `recovered` files. `undo`, `redo`, `save` act on all files.
- `edit.try` tells what an edit would do while a key is dragged (event `tried`: the plan of a window
  around it), and changes nothing. A newer one, or an edit, drops the one that waits.
- `file.new` makes a file that is not there yet, with a text for which all of this holds.
- Operations with the same `gesture`, one after the other, are one step of undo.

Unsaved edits are kept beside their file within a second; they come back after a crash.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.output import create_output
from lss_motion.playing.remote import edit_messages as e
from lss_motion.playing.remote import schema as m
from lss_motion.show.key_edit import entries_at, lists_of, times_of
from lss_motion.studio.allowed import path_inside, read, require_allowed, require_new
from lss_motion.studio.drafts import Drafts, Stamp, stamp_of
from lss_motion.studio.history import History
from lss_motion.studio.operations import RobotNames, new_texts, word_of
from lss_motion.studio.planner import EditTrial, PlannerReply, Request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

VIEWS_MAX: Final = 3
"""Views of plans that are kept, the newest: clients may still fetch the one before."""
YAML: Final = (".yaml", ".yml")


class Document:
    """One file and what was planned of it. `ask` starts planning; `changed` tells the clients."""

    def __init__(
        self,
        request: Request,
        ask: Callable[[Request], None],
        changed: Callable[[], None],
        try_edit: Callable[[EditTrial], None] = lambda _: None,
    ) -> None:
        own = request.path.resolve()
        self.folder = own if own.is_dir() else own.parent
        """Nothing outside of it is opened, or given to a client."""
        self.revision = 0
        self.good: PlannerReply | None = None
        """The last reply with a plan, or of a robot file without an error."""
        self.robot_revision = 0
        self.shown: str | None = None
        """The show of a stage whose plan clients see."""
        self._request = request
        self._ask, self._changed, self._try = ask, changed, try_edit
        self._newest = PlannerReply(number=0, title=request.path.stem)
        self._views: dict[str, bytes] = {}
        self._stamps: dict[Path, Stamp] = {}
        self._is_planning = self._is_current = False
        self._asked_s = 0.0
        self._history, self._drafts = History(), Drafts(self.folder)
        self._recover()
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
        self._require_yaml(path, name)
        top = self._request.path
        own = (top if top.is_dir() else top.parent) / path.relative_to(self.folder)
        self._request = replace(self._request, path=own)
        self.good, self._views, self._stamps = None, {}, {}
        self._newest = PlannerReply(number=0, title=path.stem)
        self._recover()
        self._plan()

    def _require_yaml(self, path: Path, name: str) -> None:
        """Raise `InputError` for what is no file that can be opened."""
        if path.suffix.lower() not in YAML or stamp_of(path) is None or path.is_dir():
            raise InputError("is no show, gait or robot (.yaml) in this folder", path=name)

    def inside(self, name: str) -> Path:
        """Return the path of a file below the folder; raises `InputError` if it is not below."""
        return path_inside(self.folder, name)

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
        older = {self.folder: stamp_of(self.folder), **self._stamps} if reply.problems else {}
        newer = {path: self._stamps.get(path, stamp_of(path)) for path in reply.files}
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
        if self._recover(reply.files):
            self._plan()
        else:
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
        """Look whether a file has changed on disk; plan again if one has. Keep unsaved edits."""
        is_edited = self._look_at_drafts()
        if self._drafts.keep():
            self._restamp_folder()
        stamps = (one for one in self._stamps.items() if one[0].resolve() not in self._drafts)
        if is_edited or any(stamp_of(path) != stamp for path, stamp in stamps):
            self._plan()

    def close(self) -> None:
        """Keep what is not saved, for the next server."""
        self._drafts.keep()

    def _look_at_drafts(self) -> bool:
        """Take what has changed on disk of files without unsaved edits; return whether any has.

        Where there are unsaved edits, clients are told what differs.
        """
        before = self._drafts.state().conflicts
        taken = self._drafts.look()
        if taken:
            self._history.add("change on disk", taken)
        elif self._drafts.state().conflicts != before:
            self._changed()
        return bool(taken)

    def _restamp_folder(self) -> None:
        """Note that the folder has changed by what was written here."""
        for path in {self.folder, self._request.path.parent} & self._stamps.keys():
            self._stamps[path] = stamp_of(path)

    # ---- edits

    def edit(self, operation: e.EditOperation, key: int = 0) -> bool:
        """Carry out an operation on files; raises `InputError` with the reason if it is refused.

        Returns whether it is answered now; what is tried is answered by the planner, with `key`.
        """
        self.require_editable()
        self.look()
        if operation.revision != self.revision:
            raise InputError(
                f"the files have changed since then (revision {self.revision}); look again"
            )
        match operation:
            case e.EditTry():
                texts = self.unsaved_texts()
                self._try(EditTrial(number=key, operation=operation.edit, texts=texts))
                return False
            case e.Undo():
                self._put(self._history.undo(self._drafts.open))
            case e.Redo():
                self._put(self._history.redo(self._drafts.open))
            case e.Save():
                self._save()
            case e.DiskKeep():
                self._keep(operation)
            case e.FileNew():
                self._new(operation)
            case _:
                assert isinstance(operation, e.AnyEdit)
                self._edit(operation)
        return True

    def require_editable(self) -> None:
        """Raise `InputError` where the files are those of a stage that runs."""
        if self.runs_stage:
            raise InputError("this server runs a stage; edit its files with lss-motion studio")

    @property
    def robot_path(self) -> Path | None:
        """The robot file of the show, as it was read last."""
        known = (self._newest, *([] if self.good is None else [self.good]))
        return next((one.robot_path for one in known if one.robot_path is not None), None)

    def name_of(self, path: Path) -> str:
        """Return a file as clients know it."""
        return self._drafts.name(path)

    def unsaved_texts(self) -> dict[Path, bytes]:
        """Return what edited files have that is not saved yet, by their full paths."""
        return {draft.path: draft.data for draft in self._drafts.unsaved()}

    def _new(self, operation: e.FileNew) -> None:
        """Make a file that is not there yet, at once: there is nothing to undo but to delete it."""
        path = self.inside(operation.file)
        require_new(self.folder, path, operation.text)
        create_output(path, operation.text)
        self._changed()

    def _edit(self, operation: Any) -> None:  # noqa: ANN401  (what `new_texts` accepts)
        changed = {
            path: (before, after)
            for path, (before, after) in new_texts(operation, self._text_of, self._robot()).items()
            if before != after
        }
        for path, (before, after) in changed.items():
            require_allowed(self.folder, path, before, after)
        if changed:
            self._history.add(word_of(operation), changed, operation.gesture)
            self._put({path: after for path, (_, after) in changed.items()})

    def _put(self, texts: Mapping[Path, str]) -> None:
        for path, text in texts.items():
            self._drafts.put(path, text)
        self._plan()

    def _save(self) -> None:
        if self._look_at_drafts():
            self._plan()
        try:
            for path in self._drafts.save():
                self._stamps = {
                    one: stamp_of(one) if one.resolve() == path else stamp
                    for one, stamp in self._stamps.items()
                }
        finally:
            self._drafts.keep()
            self._restamp_folder()
            self._changed()

    def _keep(self, operation: e.DiskKeep) -> None:
        path = self.inside(operation.file)
        if operation.what == "ours":
            self._drafts.keep_ours(path)
            self._changed()
            return
        before, after = self._drafts.keep_disk(path)
        self._history.add(f"take {operation.file} from disk", {path: (before, after)})
        self._plan()

    def _text_of(self, name: str) -> tuple[Path, str]:
        """Return the full path and the text of a file that an operation names."""
        path = self.inside(name)
        self._require_yaml(path, name)
        return path, self._drafts.open(path)

    def expect_change(self, path: Path) -> None:
        """Let the next change of a file on disk, by a process of ours, be a step of undo."""
        full = path.resolve()
        if full.is_relative_to(self.folder):
            self._drafts.open(full)
            if any(draft.path == full for draft in self._drafts.unsaved()):
                raise InputError("has edits that are not saved; save or undo them first", path=path)

    def text(self, path: Path) -> str:
        """Return the text of a file as it is edited, by its full path."""
        return self._drafts.text(path)

    def _robot(self) -> RobotNames:
        """Return the poses and images of the robot, as the planner read them last."""
        reply = self._newest if self._newest.robot else self.good
        if reply is None or not reply.robot:
            return RobotNames()
        return msgspec.json.decode(reply.robot, type=RobotNames)

    def model(self) -> dict[str, object]:
        """Return what the files of the show hold now, as edited; see the top of this module."""
        planned = {path.resolve() for path in (*self._stamps, self.path)}
        files = {}
        for path in sorted(planned):
            if path.suffix.lower() in YAML and path.is_relative_to(self.folder):
                try:
                    source = read(path, self._drafts.text(path)).source
                except InputError:
                    continue
                files[self._drafts.name(path)] = {
                    "value": source.value,
                    "lists": [
                        {
                            "place": place,
                            "times_s": times_of(source.value, place),
                            "lines": [
                                source.line((*place, index))
                                for index in range(len(entries_at(source.value, place)))
                            ],
                        }
                        for place in lists_of(source.value)
                    ],
                }
        return {"revision": self.revision, "files": files}

    def _recover(self, paths: Iterable[Path] = ()) -> bool:
        """Take unsaved edits of before, of the open file or of others; return whether any are."""
        if self.runs_stage:
            return False  # What is not saved is not played to an audience.
        inside = [path.resolve() for path in (self.path, *paths)]
        found = {
            path: (before, after)
            for path, before, after in self._drafts.recover(
                path for path in inside if path.is_relative_to(self.folder)
            )
        }
        if found:
            self._history.add("edits of before", found)
        return bool(found)

    def is_made_of(self, path: Path) -> bool:
        """Return whether a file, by its full path, is one of those that were planned."""
        return path in {one.resolve() for one in self._stamps}

    def message(self) -> m.DocumentChanged:
        """Return the state as an event."""
        newest = self._newest
        return m.DocumentChanged(
            revision=self.revision,
            file="" if newest.kind == "folder" else self.path.name,
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
            editing=replace(
                self._drafts.state(), undo=self._history.undo_word, redo=self._history.redo_word
            ),
        )

    def _plan(self) -> None:
        """Plan the file as it is on disk now."""
        self.revision += 1
        self._is_planning, self._is_current = True, False
        self._asked_s = time.monotonic()
        self._stamps = {path: stamp_of(path) for path in {*self._stamps, *self._first()}}
        self._ask(replace(self._request, texts=self.unsaved_texts()))
        self._changed()

    def _first(self) -> Iterable[Path]:
        request = self._request
        return [p for p in (request.path, request.robot_path, request.backup) if p is not None]

    def _shown(self, path: str) -> str:
        """Return a path as people know it: from the folder of the show, if it is there."""
        full = Path(path).resolve()
        return str(full.relative_to(self.folder)) if full.is_relative_to(self.folder) else path
