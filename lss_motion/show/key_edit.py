"""Edits of keyframes as an animator thinks of them: keys of joints that are moved, set, added.

A key is an item of a list of keyframes, or some joints of it. Each function takes the plain value
of a sequence file and returns the edits of its text (`files.yaml_edit`). Times are those of the
file. `at_s`, `after_s` and `at_beat` stay as the author wrote them; keyframes keep the order of
their times; what is not edited keeps its instant, or follows where `ripple` asks for that.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.yaml_edit import Edit, Insert, Remove, Rename, Reorder, SetValues, changes
from lss_motion.show.beats import beat_number, beat_time
from lss_motion.show.check import SAME_TIME_S
from lss_motion.show.file import TIME_MIN_S, KeyframeEntry
from lss_motion.show.keyframes import absolute_times

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from lss_motion.files.source import Location

    Poses = Mapping[str, Mapping[str, float]]
    Images = Mapping[str, tuple[str, int]]

TIME_KEYS: Final = ("at_s", "after_s", "at_beat")
TIME_DIGITS: Final = 6
"""Decimals of what keeps its instant; what is moved goes to whole milliseconds (`TIME_MIN_S`)."""
BEAT_DIGITS: Final = 4
"""Decimals of a beat: far below a millisecond of a slow song."""
ANGLE_DIGITS: Final = 3
"""Decimals of an angle: below the finest unit of a servo, 0.01 deg."""
KEYS: Final = frozenset(KeyframeEntry.__struct_fields__) - {"given", "deg", *TIME_KEYS}
"""What `set_keys` sets besides times and angles."""


class KeyRef(Struct, frozen=True):
    """A keyframe by its place, such as `("tracks", "jaw", "keyframes", 3)`, or joints of it."""

    place: Location
    joints: frozenset[str] | None = None


class NewKey(Struct, frozen=True):
    """A key to be added to the list of keyframes at `place`."""

    place: Location
    at_s: float
    deg: Mapping[str, float]
    values: Mapping[str, object] = {}


@dataclass(slots=True)
class _EditedKey:
    """A keyframe while a list is edited."""

    origin: int | None
    """Its index before the edit; None: it is new."""
    entry: dict[str, Any]
    was_s: float
    at_s: float
    """Before the edit, and after it."""
    is_edited: bool = False
    is_added: bool = False


class _EditedTrack:
    """One list of keyframes while it is edited."""

    def __init__(self, value: Mapping[str, Any], place: Location, poses: Poses) -> None:
        self.place, self._poses = place, poses
        self._beats_s = _beats_of(value)
        self._entries = entries_at(value, place)
        self.is_timed = len(self._entries) == 1 or any(map(_time_key, self._entries))
        """False where the planner finds the times (`fastest`): the order stands for them."""
        times_s = (
            instants(self._entries, self._beats_s, place)
            if self.is_timed
            else [float(index) for index in range(len(self._entries))]
        )
        self.items = [
            _EditedKey(index, copy.deepcopy(entry), at_s, at_s)
            for index, (entry, at_s) in enumerate(zip(self._entries, times_s, strict=True))
        ]

    def require_times(self) -> None:
        """Refuse what needs times where there are none."""
        if not self.is_timed:
            raise InputError(
                "these keyframes have no times: they are planned as fast as the limits allow; "
                "give them at_s first, or change their order"
            )

    def item(self, index: int) -> _EditedKey:
        """Return the keyframe that had this index."""
        return next(one for one in self.items if one.origin == index)

    def angles(self, item: _EditedKey) -> dict[str, float]:
        """Return the angles of a keyframe, those of its pose included."""
        pose = item.entry.get("pose")
        if pose is not None and pose not in self._poses:
            raise InputError(
                f"the angles of pose {pose!r} are not known; mend the robot file first"
            )
        return {**(self._poses[pose] if pose else {}), **item.entry.get("deg", {})}

    def without_pose(self, item: _EditedKey) -> None:
        """Give a keyframe angles in place of its pose."""
        if (pose := item.entry.get("pose")) is None:
            return
        angles = self.angles(item)
        entry = {"label": pose, **item.entry, "deg": angles}
        del entry["pose"]
        item.entry = entry

    def set_angles(self, item: _EditedKey, deg: Mapping[str, float | None]) -> None:
        """Set angles of a keyframe; None removes that of a joint."""
        if any(one is None and name not in item.entry.get("deg", {}) for name, one in deg.items()):
            self.without_pose(item)
        own = dict(item.entry.get("deg", {}))
        for name, angle in deg.items():
            if angle is not None:
                own[name] = round(angle, ANGLE_DIGITS)
            elif name in own:
                del own[name]
                if name in self._poses.get(item.entry.get("pose", ""), {}):
                    raise InputError(f"{name} has an angle by the pose here; give it another one")
        if own:
            item.entry["deg"] = own
        else:
            item.entry.pop("deg", None)
        if "slope_deg_s" in item.entry:
            keyed = self.angles(item)
            self.set_slopes(item, dict.fromkeys(item.entry["slope_deg_s"].keys() - keyed.keys()))

    def set_slopes(self, item: _EditedKey, slopes: Mapping[str, float | None]) -> None:
        """Set slopes of joints of a keyframe; None removes one: the curve finds it again."""
        own = dict(item.entry.get("slope_deg_s", {}))
        keyed = self.angles(item)
        for name, slope in slopes.items():
            if slope is None:
                own.pop(name, None)
            elif name not in keyed:
                raise InputError(f"{name} has no key here")
            else:
                own[name] = _tidy(slope, ANGLE_DIGITS)
        if own:
            item.entry["slope_deg_s"] = own
        else:
            item.entry.pop("slope_deg_s", None)

    def scale_slopes(self, item: _EditedKey, joints: Iterable[str], ratio: float) -> None:
        """Make slopes of joints of a keyframe steeper by a ratio."""
        own = item.entry.get("slope_deg_s", {})
        self.set_slopes(item, {name: ratio * own[name] for name in joints if name in own})

    def set_values(self, item: _EditedKey, values: Mapping[str, object]) -> None:
        """Set values of a keyframe besides its angles; None removes one."""
        for key, value in values.items():
            if key == "at_s":
                self.require_times()
                item.at_s, item.is_edited = _instant(value), True
            elif value is None:
                item.entry.pop(key, None)
            else:
                item.entry[key] = value

    def split(self, item: _EditedKey, joints: frozenset[str]) -> _EditedKey:
        """Move joints of a keyframe to one of their own; all of them: return the keyframe."""
        angles = self.angles(item)
        if unknown := joints - angles.keys():
            raise InputError(f"{', '.join(sorted(unknown))} has no key here")
        if joints == angles.keys():
            return item
        entry = {key: one for key, one in item.entry.items() if key not in ("pose", "label")}
        entry["deg"] = {name: angle for name, angle in angles.items() if name in joints}
        slopes = entry.pop("slope_deg_s", {})
        if own := {name: slope for name, slope in slopes.items() if name in joints}:
            entry["slope_deg_s"] = own
        self.set_angles(item, dict.fromkeys(joints))
        made = _EditedKey(None, entry, item.was_s, item.at_s, is_edited=True)
        self.items.append(made)
        return made

    def ripple(self, from_s: float, by_s: float) -> None:
        """Move all keyframes from an instant on that are not edited."""
        for item in self.items:
            if item.was_s >= from_s and not item.is_edited:
                item.at_s = round(item.at_s + by_s, TIME_DIGITS)

    def merged(self) -> None:
        """Let edited keys take the place of others of their joints at the same instant."""
        for item in [one for one in self.items if one.is_edited]:
            for other in list(self.items):
                is_met = abs(other.at_s - item.at_s) < SAME_TIME_S and not other.is_edited
                both = self._own(other) & self._own(item) if is_met else frozenset()
                if both and both == self._own(other) and "pose" not in other.entry:
                    self.items.remove(other)
                elif both and "pose" not in other.entry:
                    self.set_angles(other, dict.fromkeys(both))
            self._joined(item)

    def _joined(self, item: _EditedKey) -> None:
        """Join a new key with a keyframe of its instant.

        One that was split off joins what has the same values, so that it goes on to hold and ease
        as it did; one that is added takes those of the keyframe.
        """
        if item.origin is not None:
            return
        style = _style(item.entry)
        for other in self.items:
            is_met = other is not item and abs(other.at_s - item.at_s) < SAME_TIME_S
            others = _style(other.entry)
            is_alike = style <= others if item.is_added else style == others
            if is_met and is_alike:
                self.set_angles(other, item.entry.get("deg", {}))
                self.set_slopes(other, item.entry.get("slope_deg_s", {}))
                self.items.remove(item)
                return

    def _own(self, item: _EditedKey) -> frozenset[str]:
        return frozenset(item.entry.get("deg", {}))

    def edits(self) -> list[Edit]:
        """Return the edits of the text; raises `InputError` for times that cannot be."""
        if not self.items:
            raise InputError(
                "these are all keyframes of their list; leave one, or delete the whole track"
            )
        self.items.sort(key=lambda one: one.at_s)  # Stable: of one instant in the old order.
        if self.is_timed:
            self._write_times()
        kept = [item.origin for item in self.items if item.origin is not None]
        gone = sorted({*range(len(self._entries))} - {*kept})
        left = sorted(kept)
        order = tuple(left.index(index) for index in kept)
        found: list[Edit] = []
        if gone:
            found.append(Remove(tuple((*self.place, index) for index in gone)))
        if order != tuple(range(len(order))):
            found.append(Reorder(self.place, order))
        new, survivors = [], 0
        for item in self.items:
            if item.origin is None:
                new.append((survivors, None, item.entry))
            else:
                survivors += 1
        if new:
            found.append(Insert(self.place, tuple(new)))
        return [*found, *self._inner_edits()]

    def _inner_edits(self) -> list[Edit]:
        """Return what changes inside of the keyframes that were there before."""
        removed: list[Location] = []
        values: dict[Location, object] = {}
        names: dict[Location, str] = {}
        first: list[Edit] = []
        for index, item in enumerate(self.items):
            if item.origin is None:
                continue
            place, old = (*self.place, index), dict(self._entries[item.origin])
            before, after = _time_key(old), _time_key(item.entry)
            if before is not None and after is not None and before != after:
                names[*place, before] = after
                old = {(after if key == before else key): one for key, one in old.items()}
            elif before is None and after is not None:
                first.append(Insert(place, ((0, after, item.entry[after]),)))
                old[after] = item.entry[after]
            for edit in changes(place, old, item.entry):
                if isinstance(edit, Remove):
                    removed += edit.places
                elif isinstance(edit, SetValues):
                    values |= edit.values
        return [
            *([Rename(names)] if names else []),
            *first,
            *([Remove(tuple(removed))] if removed else []),
            *([SetValues(values)] if values else []),
        ]

    def _write_times(self) -> None:
        """Write the instants into the entries, each in the form that its author chose."""
        end_s, before_s = 0.0, -1.0
        form = next((key for one in self._entries if (key := _time_key(one))), "at_s")
        for index, item in enumerate(self.items):
            entry, key = item.entry, _time_key(item.entry)
            is_beside = abs(item.at_s - before_s) < SAME_TIME_S
            at_s = item.at_s = before_s if is_beside else item.at_s
            if key is None and (index or at_s > SAME_TIME_S):
                key = form if form != "at_beat" else "at_s"
                item.entry = entry = {key: -1.0, **entry}
            if key == "after_s" and is_beside and at_s < end_s - SAME_TIME_S:
                item.entry = entry = _renamed(entry, key, "at_s")  # Beside a key that is held.
                key = "at_s"
            stated_s = self._read(entry, key, end_s, before_s)
            if key is not None and (stated_s is None or abs(stated_s - at_s) > SAME_TIME_S / 2):
                key = self._write(item, key, end_s)
            found_s = self._read(item.entry, key, end_s, before_s)
            found_s = at_s if found_s is None else found_s
            until_s = found_s + _hold_s(item.entry)
            end_s = max(end_s, until_s) if found_s == before_s else until_s
            before_s = found_s
        instants([item.entry for item in self.items], self._beats_s, self.place)

    def _read(
        self, entry: Mapping[str, Any], key: str | None, end_s: float, before_s: float
    ) -> float | None:
        """Return the instant that an entry states now."""
        match key:
            case None:
                return 0.0
            case "at_beat":
                at_s = beat_time(self._beats_s, entry[key])
            case "after_s":
                at_s = end_s + entry[key]
            case _:
                at_s = entry[key]
        for known_s in (end_s, before_s):
            if at_s is not None and abs(at_s - known_s) < SAME_TIME_S:
                at_s = known_s
        return at_s

    def _write(self, item: _EditedKey, key: str, end_s: float) -> str:
        """Write the instant of a keyframe; return the key that holds it."""
        if key == "at_beat":
            beat = beat_number(self._beats_s, item.at_s)
            if beat is not None:
                item.entry[key] = _tidy(beat, BEAT_DIGITS)
                return key
            item.entry = _renamed(item.entry, key, "at_s")
            key = "at_s"
        at_s = item.at_s - end_s if key == "after_s" else item.at_s
        item.entry[key] = max(_tidy(at_s, TIME_DIGITS), 0.0) if at_s > -SAME_TIME_S else at_s
        if at_s <= -SAME_TIME_S:
            where = "the start" if key == "at_s" else f"{end_s:g} s, the end of the hold before it"
            raise InputError(f"the key would come before {where}")
        return key


def instants(
    entries: Sequence[Mapping[str, Any]], beats_s: Sequence[float], place: Location = ()
) -> list[float]:
    """Return the instant of each keyframe of a list; raises `InputError` where one has none."""
    made = []
    for index, entry in enumerate(entries):
        times = {key: entry.get(key) for key in TIME_KEYS}
        hold_s = entry.get("hold_s", 0.0)
        for key, one in (*times.items(), ("hold_s", hold_s)):
            if one is not None and (type(one) not in (int, float) or not 0.0 <= one < 1e6):
                raise InputError(f"{_shown(place, index)}: {key} is no time; mend it in the text")
        if times["at_beat"] is not None:
            times["at_s"] = beat_time(beats_s, times["at_beat"])
        made.append(
            KeyframeEntry(
                at_s=None if times["at_s"] is None else float(times["at_s"]),
                after_s=None if times["after_s"] is None else float(times["after_s"]),
                hold_s=float(hold_s),
            )
        )
    times_s, problems = absolute_times(made, ())
    if problems:
        index = next((part for part in problems[0].location if isinstance(part, int)), 0)
        raise InputError(f"{_shown(place, index)}: {problems[0].reason}")
    return [at_s for at_s in times_s if at_s is not None]


def move_keys(
    value: Mapping[str, Any],
    keys: Iterable[KeyRef],
    poses: Poses,
    *,
    by_s: float = 0.0,
    by_deg: Mapping[str, float] = {},
    ripple: bool = False,
) -> list[Edit]:
    """Move keys in time and by angles; with `ripple` all that come later move as well.

    Joints of a keyframe that are moved alone get a keyframe of their own.
    """
    by_s = round(by_s / TIME_MIN_S) * TIME_MIN_S

    def to(at_s: float) -> float:
        return at_s + by_s

    def turned(angles: Mapping[str, float]) -> dict[str, float]:
        return {name: angles[name] + by for name, by in by_deg.items() if name in angles}

    return _moved(value, keys, poses, to, turned, ripple_s=by_s if ripple else 0.0)


def scale_keys(
    value: Mapping[str, Any],
    keys: Iterable[KeyRef],
    poses: Poses,
    *,
    ratio: float,
    about_s: float | None = None,
    about_deg: Mapping[str, float] = {},
) -> list[Edit]:
    """Scale the times of keys about an instant, and the angles of joints about one of each."""

    def to(at_s: float) -> float:
        if about_s is None:
            return at_s
        return round((about_s + (at_s - about_s) * ratio) / TIME_MIN_S) * TIME_MIN_S

    def turned(angles: Mapping[str, float]) -> dict[str, float]:
        return {
            name: about + (angles[name] - about) * ratio
            for name, about in about_deg.items()
            if name in angles
        }

    steeper = ratio if about_s is None else 1.0 / ratio if ratio else 1.0
    only = frozenset(about_deg) if about_s is None else None
    return _moved(value, keys, poses, to, turned, steeper=(only, steeper))


def mirror_keys(
    value: Mapping[str, Any], keys: Iterable[KeyRef], poses: Poses, images: Images
) -> list[Edit]:
    """Exchange left and right of keys; a joint without an image stays as it is.

    `images` gives for a joint that of the other side, and the sign of the angle there. Of joints
    that are mirrored alone, the image takes the angle whatever it had.
    """
    found: list[Edit] = []
    has_image = False
    for track, refs in _tracks(value, keys, poses):
        for ref in refs:
            item = track.item(int(ref.place[-1]))
            angles = track.angles(item)
            own = [name for name in angles if ref.joints is None or name in ref.joints]
            pairs = {name: images[name] for name in own if name in images}
            gone: dict[str, float | None] = dict.fromkeys(pairs)
            made = {image: sign * angles[name] for name, (image, sign) in pairs.items()}
            if pairs:
                has_image = True
                track.without_pose(item)
                slopes = item.entry.get("slope_deg_s", {})
                track.set_angles(item, {**gone, **made})
                sides = [(*pairs[name], one) for name, one in slopes.items() if name in pairs]
                exchanged = {image: sign * one for image, sign, one in sides}
                track.set_slopes(item, {**dict.fromkeys({*gone, *made}), **exchanged})
        found += track.edits()
    if not has_image:
        raise InputError(
            "nothing to mirror: the robot file gives none of these joints an image; write pairs "
            "under its key mirror"
        )
    return found


def _moved(
    value: Mapping[str, Any],
    keys: Iterable[KeyRef],
    poses: Poses,
    to: Callable[[float], float],
    turned: Callable[[Mapping[str, float]], dict[str, float]],
    ripple_s: float = 0.0,
    steeper: tuple[frozenset[str] | None, float] = (None, 1.0),
) -> list[Edit]:
    """Move keys to instants and angles; `steeper`: joints, None for all, and a ratio of slopes."""
    found: list[Edit] = []
    for track, refs in _tracks(value, keys, poses):
        moved = []
        for ref in refs:
            item = track.item(int(ref.place[-1]))
            at_s = to(item.at_s)
            is_time = abs(at_s - item.at_s) > SAME_TIME_S
            if is_time:
                track.require_times()
            if ref.joints is not None and is_time and not ripple_s:
                item = track.split(item, ref.joints)
            item.at_s, item.is_edited = round(at_s, TIME_DIGITS), True
            moved.append(item)
            angles = track.angles(item)
            names = angles.keys() if ref.joints is None else ref.joints
            if own := turned({name: angles[name] for name in angles if name in names}):
                track.set_angles(item, own)
            if steeper[1] != 1.0:
                track.scale_slopes(item, names if steeper[0] is None else steeper[0], steeper[1])
        if ripple_s:
            track.ripple(min(item.was_s for item in moved), ripple_s)
        if min(item.at_s for item in moved) < -SAME_TIME_S:
            raise InputError("the key would come before the start")
        track.merged()
        found += track.edits()
    return found


def set_keys(
    value: Mapping[str, Any],
    keys: Iterable[KeyRef],
    poses: Poses,
    *,
    deg: Mapping[str, float | None] = {},
    slope_deg_s: Mapping[str, float | None] = {},
    values: Mapping[str, object] = {},
    ripple: bool = False,
) -> list[Edit]:
    """Set angles, slopes and other values of keys; None removes one. `values` may have `at_s`.

    Keyframes behind one whose `hold_s` changes keep their instants, or move with `ripple`.
    """
    if unknown := values.keys() - KEYS - {"at_s"}:
        raise InputError(f"{', '.join(sorted(unknown))}: a key has no such value")
    found: list[Edit] = []
    for track, refs in _tracks(value, keys, poses):
        for ref in refs:
            item = track.item(int(ref.place[-1]))
            held_s = _hold_s(item.entry)
            if "pose" in values:
                item.entry.pop("pose", None)
            track.set_angles(item, deg)
            track.set_values(item, values)
            if slope_deg_s:
                track.set_slopes(item, slope_deg_s)
            if "deg" not in item.entry and "pose" not in item.entry:
                track.items.remove(item)
            more_s = _hold_s(item.entry) - held_s
            for other in track.items if ripple and more_s else ():
                if other.was_s > item.was_s:
                    other.at_s = round(other.at_s + more_s, TIME_DIGITS)
        track.merged()
        found += track.edits()
    return found


def add_keys(value: Mapping[str, Any], keys: Iterable[NewKey], poses: Poses) -> list[Edit]:
    """Add keys to lists of keyframes; at an instant that has a keyframe they join it."""
    by_place: dict[Location, list[NewKey]] = {}
    for key in keys:
        by_place.setdefault(key.place, []).append(key)
    found: list[Edit] = []
    for place, new in by_place.items():
        track = _EditedTrack(value, place, poses)
        track.require_times()
        for key in new:
            if unknown := key.values.keys() - KEYS:
                raise InputError(f"{', '.join(sorted(unknown))}: a key has no such value")
            at_s = _instant(key.at_s)
            entry: dict[str, Any] = {track_form(value, place): -1.0}
            if "pose" in key.values:
                entry["pose"] = key.values["pose"]
            if key.deg:
                entry["deg"] = {name: round(one, ANGLE_DIGITS) for name, one in key.deg.items()}
            elif "pose" not in entry:
                raise InputError("a key names at least one joint, or a pose")
            entry |= {name: one for name, one in key.values.items() if one is not None}
            track.items.append(_EditedKey(None, entry, at_s, at_s, is_edited=True, is_added=True))
        track.merged()
        found += track.edits()
    return found


def delete_keys(
    value: Mapping[str, Any], keys: Iterable[KeyRef], poses: Poses, *, ripple: bool = False
) -> list[Edit]:
    """Delete keyframes, or joints of them; with `ripple` later ones close the gap."""
    found: list[Edit] = []
    for track, refs in _tracks(value, keys, poses):
        for ref in refs:
            item = track.item(int(ref.place[-1]))
            joints = track.angles(item).keys() if ref.joints is not None else frozenset()
            if ref.joints is not None and ref.joints < joints:
                track.set_angles(item, dict.fromkeys(ref.joints))
                continue
            if ref.joints is not None and not ref.joints <= joints:
                raise InputError(f"{', '.join(sorted(ref.joints - joints))} has no key here")
            earlier = [one for one in track.items if one.was_s < item.was_s - SAME_TIME_S]
            end_s = max((one.was_s + _hold_s(one.entry) for one in earlier), default=0.0)
            less_s = item.was_s + _hold_s(item.entry) - end_s
            track.items.remove(item)
            for other in track.items if ripple else ():
                if other.was_s > item.was_s + SAME_TIME_S:
                    other.at_s = round(max(other.at_s - less_s, 0.0), TIME_DIGITS)
        found += track.edits()
    return found


def track_form(value: Mapping[str, Any], place: Location) -> str:
    """Return the key with which a list of keyframes gives its times."""
    forms = [key for entry in entries_at(value, place) if (key := _time_key(entry))]
    return max(forms, key=forms.count) if forms else "at_s"


def entries_at(value: Mapping[str, Any], place: Location) -> list[dict[str, Any]]:
    """Return the list of keyframes at a place of a file; raises `InputError` if it is none."""
    node: Any = value
    for part in place:
        node = node.get(part) if isinstance(node, dict) else None
    is_list = place[-1:] == ("keyframes",) and isinstance(node, list)
    if not is_list or not all(isinstance(entry, dict) for entry in node):
        raise InputError(f"{'.'.join(map(str, place))} is no list of keyframes of this file")
    if not all(isinstance(entry.get("deg", {}), dict) for entry in node):
        raise InputError("deg of a keyframe is no mapping; mend it in the text")
    return list(node)


def lists_of(value: Mapping[str, Any]) -> list[Location]:
    """Return the places of all lists of keyframes of a file."""
    tracks = value.get("tracks")
    places: list[Location] = [("keyframes",)]
    places += [("tracks", name, "keyframes") for name in tracks or () if isinstance(tracks, dict)]
    found = []
    for place in places:
        try:
            entries_at(value, place)
        except InputError:
            continue
        found.append(place)
    return found


def times_of(value: Mapping[str, Any], place: Location) -> list[float] | None:
    """Return the instants of a list of keyframes; None where they are not known."""
    try:
        return instants(entries_at(value, place), _beats_of(value), place)
    except InputError:
        return None


def _tracks(
    value: Mapping[str, Any], keys: Iterable[KeyRef], poses: Poses
) -> Iterable[tuple[_EditedTrack, list[KeyRef]]]:
    """Yield each list that has some of the keys, with them; a key counts once."""
    by_place: dict[Location, dict[int, KeyRef]] = {}
    for key in keys:
        index = key.place[-1] if key.place else None
        if not isinstance(index, int):
            raise InputError("a key has the place of a keyframe, such as keyframes.3")
        of = by_place.setdefault(key.place[:-1], {})
        before = of.get(index, key)
        is_part = before.joints is not None and key.joints is not None
        joints = (before.joints or frozenset()) | (key.joints or frozenset())
        of[index] = KeyRef(key.place, joints if is_part else None)
    for place, refs in by_place.items():
        count = len(entries_at(value, place))
        if beyond := [index for index in refs if not 0 <= index < count]:
            raise InputError(f"there is no keyframe {beyond[0]} in {'.'.join(map(str, place))}")
        yield _EditedTrack(value, place, poses), list(refs.values())


def _beats_of(value: Mapping[str, Any]) -> tuple[float, ...]:
    beats = value.get("beats")
    given = beats.get("at_s") if isinstance(beats, dict) else beats
    is_read = isinstance(given, list) and all(type(one) in (int, float) for one in given)
    return tuple(given) if is_read and given else ()


def _instant(at_s: object) -> float:
    if type(at_s) not in (int, float) or not isinstance(at_s, int | float):
        raise InputError(f"{at_s!r} is no time")
    found = round(round(at_s / TIME_MIN_S) * TIME_MIN_S, TIME_DIGITS)
    if found < 0.0:
        raise InputError("the key would come before the start")
    return found


def _hold_s(entry: Mapping[str, Any]) -> float:
    hold_s = entry.get("hold_s", 0.0)
    return float(hold_s) if type(hold_s) in (int, float) else 0.0


def _style(entry: Mapping[str, Any]) -> set[tuple[str, str]]:
    """Return what a keyframe says besides its instant, its angles and its name."""
    own = (*TIME_KEYS, "deg", "pose", "label", "slope_deg_s")
    return {(key, repr(one)) for key, one in entry.items() if key not in own}


def _time_key(entry: Mapping[str, Any]) -> str | None:
    return next((key for key in TIME_KEYS if key in entry), None)


def _renamed(entry: Mapping[str, Any], key: str, name: str) -> dict[str, Any]:
    return {(name if one == key else one): value for one, value in entry.items()}


def _tidy(number: float, digits: int) -> float | int:
    """Return a number as a person writes it: 2, not 2.0."""
    found = round(number, digits)
    return int(found) if found == int(found) else found


def _shown(place: Location, index: int) -> str:
    return ".".join(map(str, (*place, index)))
