"""Operations on the open files of a studio, and what the server says of them.

Every operation names the `revision` on which it was made, that of the last event `document`; a
stale one is refused. Operations that share a `gesture` (of one client, one after the other) are
one step for `undo`. `file` is a file as the view names it, relative to the folder of the show.
A `place` is the way from the top of that file to a value: keys, and indices from 0, such as
`["tracks", "jaw", "keyframes", 3]`. Times are seconds of that file.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from msgspec import Meta, field

from lss_motion.playing.remote.message import LABEL_MAX_CHARS, Event, Message, Name, Operation

PLACE_MAX: Final = 16
"""As deep as a file may be nested."""
KEYS_MAX: Final = 5000
"""Chosen: more than a person selects."""
TIME_MAX_S: Final = 86_400.0
TURN_MAX_DEG: Final = 36_000.0
RATIO_MAX: Final = 100.0
LINES_MAX: Final = 100_000

Part = Annotated[int, Meta(ge=0)] | Annotated[str, Meta(max_length=LABEL_MAX_CHARS)]
Place = Annotated[tuple[Part, ...], Meta(max_length=PLACE_MAX)]
FileName = Annotated[str, Meta(min_length=1, max_length=1000)]
Angle = Annotated[float, Meta(ge=-TURN_MAX_DEG, le=TURN_MAX_DEG)]
ShiftS = Annotated[float, Meta(ge=-TIME_MAX_S, le=TIME_MAX_S)]
AtS = Annotated[float, Meta(ge=0.0, le=TIME_MAX_S)]
Joints = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=100)]


class KeyOf(Message, frozen=True, kw_only=True):
    """A keyframe of a file, or some `joints` of it."""

    file: FileName
    place: Place
    joints: Joints | None = None


class AddedKey(Message, frozen=True, kw_only=True):
    """A key for the list of keyframes at `place`: angles, and other values of a keyframe."""

    file: FileName
    place: Place
    at_s: AtS
    deg: Annotated[dict[Name, Angle], Meta(max_length=100)] = field(default_factory=dict)
    values: dict[Name, Any] = field(default_factory=dict)


Keys = Annotated[tuple[KeyOf, ...], Meta(min_length=1, max_length=KEYS_MAX)]


class EditOperation(Operation, frozen=True, kw_only=True):
    """Base of all operations on files."""

    revision: Annotated[int, Meta(ge=0)]
    gesture: Annotated[str, Meta(max_length=LABEL_MAX_CHARS)] | None = None


class KeyMove(EditOperation, frozen=True, kw_only=True, tag="key.move"):
    """Move keys by a time, and by angles of the joints that are named.

    Joints that are moved alone get a keyframe of their own, or join one of that instant. `ripple`:
    what comes later moves as well.
    """

    keys: Keys
    by_s: ShiftS = 0.0
    by_deg: Annotated[dict[Name, Angle], Meta(max_length=100)] = field(default_factory=dict)
    ripple: bool = False


class KeyScale(EditOperation, frozen=True, kw_only=True, tag="key.scale"):
    """Scale the times of keys about an instant, or the angles of joints about one of each."""

    keys: Keys
    ratio: Annotated[float, Meta(ge=-RATIO_MAX, le=RATIO_MAX)]
    about_s: AtS | None = None
    """None: the times stay."""
    about_deg: Annotated[dict[Name, Angle], Meta(max_length=100)] = field(default_factory=dict)


class KeyMirror(EditOperation, frozen=True, kw_only=True, tag="key.mirror"):
    """Exchange left and right of keys, as given under `mirror` in the robot file."""

    keys: Keys


class KeySet(EditOperation, frozen=True, kw_only=True, tag="key.set"):
    """Set angles, slopes and values (`at_s`, `ease`, `hold_s`, `label`, …); null removes one."""

    keys: Keys
    deg: Annotated[dict[Name, Angle | None], Meta(max_length=100)] = field(default_factory=dict)
    slope_deg_s: Annotated[dict[Name, Angle | None], Meta(max_length=100)] = field(
        default_factory=dict
    )
    values: dict[Name, Any] = field(default_factory=dict)
    ripple: bool = False


class KeyAdd(EditOperation, frozen=True, kw_only=True, tag="key.add"):
    """Add keys; at an instant that has a keyframe of the same values they join it."""

    keys: Annotated[tuple[AddedKey, ...], Meta(min_length=1, max_length=KEYS_MAX)]


class KeyDelete(EditOperation, frozen=True, kw_only=True, tag="key.delete"):
    """Delete keyframes, or joints of them; with `ripple` later ones close the gap."""

    keys: Keys
    ripple: bool = False


class ItemInsert(EditOperation, frozen=True, kw_only=True, tag="item.insert"):
    """Insert a value into the list at `place`, before the item `index`; a missing list is made."""

    file: FileName
    place: Place
    index: Annotated[int, Meta(ge=0)]
    value: Any


class ItemDelete(EditOperation, frozen=True, kw_only=True, tag="item.delete"):
    """Delete an item of the list at `place`, with its comments; the last one with its list."""

    file: FileName
    place: Place
    index: Annotated[int, Meta(ge=0)]


class ItemMove(EditOperation, frozen=True, kw_only=True, tag="item.move"):
    """Move an item of the list at `place`, with its comments: it becomes item `to`."""

    file: FileName
    place: Place
    index: Annotated[int, Meta(ge=0)]
    to: Annotated[int, Meta(ge=0)]


class ValueSet(EditOperation, frozen=True, kw_only=True, tag="value.set"):
    """Set the value at `place`, which is made where it does not exist; null removes its key."""

    file: FileName
    place: Annotated[Place, Meta(min_length=1)]
    value: Any


class ValueRename(EditOperation, frozen=True, kw_only=True, tag="value.rename"):
    """Give the key at `place` another name, such as that of a track."""

    file: FileName
    place: Annotated[Place, Meta(min_length=1)]
    name: Name


class FileNew(EditOperation, frozen=True, kw_only=True, tag="file.new"):
    """Make a sequence, gait or robot file with this text; one that is there is never overwritten.

    `undo` does not delete it.
    """

    file: FileName
    text: str


class TextSet(EditOperation, frozen=True, kw_only=True, tag="text.set"):
    """Replace the lines from `from_line` (from 1) to before `to_line`; ends of lines are kept."""

    file: FileName
    from_line: Annotated[int, Meta(ge=1)]
    to_line: Annotated[int, Meta(ge=1)]
    lines: Annotated[tuple[str, ...], Meta(max_length=LINES_MAX)]


AnyChange = (
    KeyMove
    | KeyScale
    | KeyMirror
    | KeySet
    | KeyAdd
    | KeyDelete
    | ItemInsert
    | ItemDelete
    | ItemMove
    | ValueSet
    | ValueRename
    | TextSet
)
"""What changes the text of files."""


class EditTry(EditOperation, frozen=True, kw_only=True, tag="edit.try"):
    """Tell what an edit would do, in the event `tried`; nothing changes. The newest wins."""

    edit: AnyChange


class Undo(EditOperation, frozen=True, kw_only=True, tag="undo"):
    """Restore the bytes of all files before the last step."""


class Redo(EditOperation, frozen=True, kw_only=True, tag="redo"):
    """Do again what was undone last."""


class Save(EditOperation, frozen=True, kw_only=True, tag="save"):
    """Write all edited files; one that has changed on disk since then is never overwritten."""


class DiskKeep(EditOperation, frozen=True, kw_only=True, tag="disk.keep"):
    """Of a file that has changed on disk: keep what is edited (`ours`), or what is on `disk`.

    `ours` makes the text on disk, as the event `document` showed it, what the next save replaces.
    """

    file: FileName
    what: Literal["ours", "disk"]


AnyEdit = AnyChange | FileNew | EditTry | Undo | Redo | Save | DiskKeep


class TriedKey(Message, frozen=True, kw_only=True):
    """A keyframe in the window of an edit: when it would be reached."""

    place: str
    """File and line of it, such as `wave.yaml:6`."""
    label: str
    authored_s: float
    planned_s: float
    is_missed: bool
    """It is an anchor, and late: the plan of the whole would fail."""


class TriedSlow(Message, frozen=True, kw_only=True):
    """A span that would be slower than authored: which limit of which joint binds."""

    from_s: float
    to_s: float
    by_s: float
    joint: str
    limit: str
    text: str


class TriedWindow(Message, frozen=True, kw_only=True):
    """The plan around an edit; outside of it all is as planned, `later_s` later behind it."""

    from_s: float
    to_s: float
    later_s: float
    is_joined: bool
    """Else only the plan of the whole can tell what the edit does."""
    keys: tuple[TriedKey, ...]
    slow: tuple[TriedSlow, ...]
    step_s: float
    deg: dict[str, str]
    """The angles of each joint from `from_s` on, a step apart: base64 of little-endian f32."""


class Tried(Event, frozen=True, kw_only=True, tag="tried"):
    """What the edit of the operation `id` would do.

    `problem`: why it could not be planned. Without that and without a `window`, only the plan of
    the whole can tell: make the edit.
    """

    id: int
    revision: int
    problem: str | None
    window: TriedWindow | None


class Conflict(Message, frozen=True, kw_only=True):
    """An edited file that has changed on disk: the lines that differ, from disk to ours."""

    file: str
    difference: tuple[str, ...]


class Editing(Message, frozen=True, kw_only=True):
    """State of the edits: what can be undone, and what is not saved."""

    undo: str | None = None
    """What `undo` would undo; None: nothing."""
    redo: str | None = None
    unsaved: tuple[str, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    recovered: tuple[str, ...] = ()
    """Files whose edits were found after a server had ended without saving them."""
