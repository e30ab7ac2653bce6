"""The keyframes of one track: absolute times, angles in place of poses, all of it checked.

`TrackLoader` makes the `Sequence` of one track of a file and collects what is wrong with it.
`at_speed` divides every time of a sequence by its `speed_ratio`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake
from lss_motion.show.check import (
    SAME_TIME_S,
    clashes,
    joint_problems,
    jumps,
    loop_problem,
    slope_problems,
)
from lss_motion.show.model import TIME_MAX_S, Interpolation, Keyframe, Sequence, Timing

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterable, Iterator, Mapping

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.robot.model import Robot
    from lss_motion.show.file import Keep, KeyframeEntry, TrackEntry
    from lss_motion.show.model import Cue, Layer, PlaylistStep


def kept_joints(
    keep: Keep | Mapping[str, Keep] | None,
    keyed: Collection[str],
    groups: Mapping[str, Collection[str]],
    default: frozenset[str],
) -> frozenset[str]:
    """Return the joints of `keyed` that keep their time by a key `keep`; `default` without it."""
    if keep is None:
        return default
    if isinstance(keep, str):
        return frozenset(keyed) if keep == "time" else frozenset()
    kept = default
    for name, kind in keep.items():
        joints = frozenset(groups.get(name, (name,))) & frozenset(keyed)
        kept = kept | joints if kind == "time" else kept - joints
    return kept


def has_times(content: TrackEntry) -> bool:
    """Return whether any keyframe has a time."""
    return any(_has_time(entry) for entry in content.keyframes)


def timing_of(content: TrackEntry) -> Timing:
    """Return the timing of the file; by default it depends on whether the keyframes have times."""
    if content.timing is not None:
        return Timing(content.timing)
    return Timing.AUTHORED if has_times(content) else Timing.FASTEST


def timing_problems(content: TrackEntry) -> Iterator[Mistake]:
    """Yield contradictions between `timing`, `duration_s`, the times and the anchors."""
    timing = timing_of(content)
    if timing is Timing.FIT and content.duration_s is None:
        yield Mistake(("timing",), "timing: fit needs 'duration_s', the time that one pass takes")
    if timing is not Timing.FIT and content.duration_s is not None:
        yield Mistake(
            ("duration_s",),
            f"duration_s ({content.duration_s:g}) belongs to timing: fit; add that, or remove it",
        )
    if timing is Timing.AUTHORED and not has_times(content) and len(content.keyframes) > 1:
        yield Mistake(
            ("timing",),
            "timing: authored, but no keyframe has 'at_s' or 'after_s'; give them, or write "
            "timing: fastest",
        )
    for index, entry in enumerate(content.keyframes):
        if timing is Timing.FASTEST and _has_time(entry):
            key = "after_s" if entry.at_s is None else "at_s"
            yield Mistake(
                ("keyframes", index, key),
                f"{key}: timing: fastest finds the times itself; remove it, or write timing: "
                "authored",
            )
        if entry.anchor and timing is not Timing.AUTHORED:
            yield Mistake(
                ("keyframes", index, "anchor"),
                f"an anchor keeps an authored time, but timing is {timing}; remove it, or give "
                "times and write timing: authored",
            )


def absolute_times(
    entries: Iterable[KeyframeEntry], unread: Container[int]
) -> tuple[list[float | None], list[Mistake]]:
    """Return the time of every keyframe, and what is wrong with the times.

    None stands for a time that is unknown because that keyframe, or one before it, is wrong. A time
    that equals the one before or its end, except for rounding, is set to exactly that. Keyframes at
    one instant end together, with the longest of their holds.
    """
    times_s: list[float | None] = []
    problems: list[Mistake] = []
    end_s: float | None = 0.0
    for index, entry in enumerate(entries):
        before_s = times_s[-1] if times_s else None
        if index in unread:
            at_s = None
        else:
            at_s, found = _time(index, entry, before_s, end_s)
            problems += [Mistake(("keyframes", index, key), reason) for key, reason in found]
        times_s.append(at_s)
        is_same = at_s is not None and at_s == before_s and end_s is not None
        until_s = None if at_s is None else at_s + entry.hold_s
        end_s = max(end_s or 0.0, until_s or 0.0) if is_same else until_s
    return times_s, problems


def _has_time(entry: KeyframeEntry) -> bool:
    return entry.at_s is not None or entry.after_s is not None


def _time(
    index: int, entry: KeyframeEntry, before_s: float | None, end_s: float | None
) -> tuple[float | None, list[tuple[str, str]]]:
    """Return the time of one keyframe; `end_s` is the end of the one before, its hold included."""
    match entry.at_s, entry.after_s:
        case None, None if index == 0:
            return 0.0, []
        case None, None:
            return None, [("at_s", "a keyframe needs 'at_s' or 'after_s', like the others")]
        case None, float(after_s):
            if end_s is None:
                return None, []
            at_s, key = end_s + after_s, "after_s"
        case float(at_s), None:
            key = "at_s"
        case _:
            return None, [("after_s", "'at_s' and 'after_s' exclude each other; keep one")]
    for known_s in (end_s, before_s):
        if known_s is not None and abs(at_s - known_s) < SAME_TIME_S:
            at_s = known_s
    return at_s, [(key, reason) for reason in _order_problems(key, at_s, before_s, end_s)]


def _order_problems(
    key: str, at_s: float, before_s: float | None, end_s: float | None
) -> Iterator[str]:
    if at_s > TIME_MAX_S:
        yield f"{key}: comes to {at_s:g} s, more than a day ({TIME_MAX_S:g} s)"
    if before_s is None or end_s is None:
        return
    if at_s < before_s:
        yield f"{key}: times must increase, but this is {at_s:g} s after {before_s:g} s"
    elif before_s < at_s < end_s:
        yield (
            f"{key}: {at_s:g} s is before the end of the keyframe before, which is held until "
            f"{end_s:g} s; come later, or shorten its hold_s"
        )


@dataclass(slots=True)
class TrackLoader:
    """Builds the sequence of one track and collects its problems.

    `place` is the location of the track in the file. `left_out` has the locations below it whose
    content could not be read; they are not reported again.
    """

    content: TrackEntry
    place: Location
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    is_offset: bool = False
    """The angles are added to others, so no range applies to them alone."""
    is_looped_in_part: bool = False
    smooth_s: float = 0.0
    """Default of `smooth_s` where the track does not give it."""
    holds_may_shrink: bool = False
    """Default of `hold_may_shrink` where neither keyframe nor track gives it."""
    keep: Keep | Mapping[str, Keep] | None = None
    """Default of `keep` where the track does not give it: that of the file."""
    problems: list[Mistake] = field(default_factory=list)

    def sequence(self, name: str) -> Sequence:
        """Return the sequence; it can be played only if there are no `problems`."""
        content, unread = self.content, self._unread()
        keyframes = [self._keyframe(i, entry) for i, entry in enumerate(content.keyframes)]
        if not unread and not self.left_out & {("timing",), ("duration_s",)}:
            for problem in timing_problems(content):
                self._note(problem.location, problem.reason)
        timing = timing_of(content)
        if timing is not Timing.FASTEST and (has_times(content) or timing is Timing.AUTHORED):
            keyframes = self._timed(keyframes, unread)
        if self.robot is not None:
            self._check_joints(keyframes, self.robot)
        self._check_slopes(keyframes, timing)
        loop = None if content.loop == "forever" else content.loop
        kept = self._kept(keyframes)
        marked = self._marked(keyframes)
        is_whole = not self.problems and not self.left_out and self.robot is not None
        is_looped = loop != 1 and not self.is_looped_in_part
        if is_looped and is_whole and (reason := loop_problem(keyframes)):
            self._note(("keyframes", len(keyframes) - 1), reason)
        self._check_kept(keyframes, kept, marked)
        return Sequence(
            name=name,
            keyframes=tuple(self._with_exact(keyframes, kept, marked)),
            path=self.source.path,
            robot_path=None if self.robot is None else self.robot.path,
            timing=timing,
            fit_duration_s=content.duration_s,
            loop=loop,
            keeps_time=kept | marked,
            smooth_s=self.smooth_s if content.smooth_s is None else content.smooth_s,
        )

    def _kept(self, keyframes: list[Keyframe]) -> frozenset[str]:
        """Return the joints that keep their time by track or file, and note unknown ones."""
        keyed = frozenset(name for frame in keyframes for name in frame.deg)
        own, default = self.content.keep, self.keep
        known = [] if self.robot is None else [*self.robot.joints, *self.robot.groups]
        for name in own if isinstance(own, dict) and self.robot is not None else ():
            if name not in known:
                reason = f"unknown joint or group {name!r}; {known_names(name, known)}"
                self._note(("keep", name), f"keep: {reason}")
        groups = {} if self.robot is None else self.robot.groups
        default_kept = kept_joints(default, keyed, groups, frozenset())
        return kept_joints(own, keyed, groups, default_kept)

    def _marked(self, keyframes: list[Keyframe]) -> frozenset[str]:
        """Return the joints of keyframes with `keep: time`."""
        pairs = zip(self.content.keyframes, keyframes, strict=True)
        return frozenset(name for entry, frame in pairs if entry.keep for name in frame.deg)

    def _check_kept(
        self, keyframes: list[Keyframe], kept: frozenset[str], marked: frozenset[str]
    ) -> None:
        """Note what contradicts that joints keep their time."""
        without_times = "keep: time keeps the author's times, but this file gives none"
        is_fastest = timing_of(self.content) is Timing.FASTEST
        if kept and is_fastest and self.content.keep is not None:
            self._note(("keep",), without_times)
        for index, (entry, frame) in enumerate(zip(self.content.keyframes, keyframes, strict=True)):
            for key in ("exact", "weight"):
                is_given = key in entry.given and frame.deg
                if is_given and not (kept | marked) & {*frame.deg}:
                    self._note(
                        ("keyframes", index, key),
                        f"{key} is for joints that keep their time; write keep: time for one of "
                        f"{', '.join(frame.deg)}, or remove it (anchor: true keeps the time of "
                        "joints that keep the angle)",
                    )
            if entry.keep and entry.exact:
                self._note(
                    ("keyframes", index, "keep"),
                    "keep: time gives up the angle here, and exact keeps it; remove one of them",
                )
            if entry.keep and is_fastest:
                self._note(("keyframes", index, "keep"), without_times)

    def _with_exact(
        self, keyframes: list[Keyframe], kept: frozenset[str], marked: frozenset[str]
    ) -> list[Keyframe]:
        """Return the keyframes; the joints of `marked` alone give up angle only where they say so.

        A keyframe that is exact for some of the joints that keep their time, and not for others,
        becomes two of one instant.
        """
        found = []
        for entry, frame in zip(self.content.keyframes, keyframes, strict=True):
            own = {} if entry.keep or entry.exact else marked - kept
            both = {name: deg for name, deg in frame.deg.items() if name in own}
            rest = {name: deg for name, deg in frame.deg.items() if name not in own}
            if both and kept & {*rest}:
                found += [replace(frame, deg=rest), replace(frame, deg=both, is_exact=True)]
            else:
                found.append(replace(frame, is_exact=True) if both else frame)
        return found

    def _unread(self) -> frozenset[int]:
        """Return the keyframes that could not be read; the loader has blanks in their place."""
        return frozenset(part for _, *rest in self.left_out for part in rest if type(part) is int)

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake((*self.place, *location), reason))

    def _keyframe(self, index: int, entry: KeyframeEntry) -> Keyframe:
        is_read = ("keyframes", index) not in self.left_out
        given = (entry.hold_may_shrink, self.content.hold_may_shrink, self.holds_may_shrink)
        if not entry.deg and entry.pose is None and is_read:
            self._note(("keyframes", index), "a keyframe names joints: give 'pose' or 'deg'")
        return Keyframe(
            deg={**self._pose(index, entry.pose), **(entry.deg or {})},
            hold_s=entry.hold_s,
            hold_may_shrink=next(may for may in given if may is not None),
            is_anchor=entry.anchor,
            is_exact=entry.exact,
            weight=entry.weight,
            ease=Interpolation(entry.ease or self.content.interpolation),
            label=entry.label or entry.pose or "",
            slope_deg_s=entry.slope_deg_s or {},
            line=self.source.line((*self.place, "keyframes", index)),
            place=(*self.place, "keyframes", index),
        )

    def _pose(self, index: int, name: str | None) -> Mapping[str, float]:
        if name is None or self.robot is None:
            return {}
        if name not in self.robot.poses:
            known = known_names(name, self.robot.poses)
            self._note(("keyframes", index, "pose"), f"unknown pose {name!r}; {known}")
        return self.robot.poses.get(name, {})

    def _timed(self, keyframes: list[Keyframe], unread: frozenset[int]) -> list[Keyframe]:
        times_s, problems = absolute_times(self.content.keyframes, unread)
        if has_times(self.content):  # Else `timing_problems` has reported it once for all.
            for problem in problems:
                self._note(problem.location, problem.reason)
        timed = [replace(k, at_s=at_s) for k, at_s in zip(keyframes, times_s, strict=True)]
        for index, reason in (*jumps(timed), *clashes(timed)):
            self._note(("keyframes", index), reason)
        return timed

    def _check_slopes(self, keyframes: list[Keyframe], timing: Timing) -> None:
        for index, name, reason in slope_problems(keyframes, timing):
            self._note(("keyframes", index, "slope_deg_s", name), f"slope_deg_s: {reason}")

    def _check_joints(self, keyframes: list[Keyframe], robot: Robot) -> None:
        for index, name, reason in joint_problems(keyframes, robot, is_offset=self.is_offset):
            is_own = name in (self.content.keyframes[index].deg or {})
            key = ("deg", name) if is_own else ("pose",)
            self._note(("keyframes", index, *key), reason)


def at_speed(sequence: Sequence, ratio: float = 1.0) -> Sequence:
    """Return the sequence with all times divided by `ratio` and by its own `speed_ratio`.

    A sequence whose timing is `fastest` has no times: it keeps the product as its `speed_ratio`
    for the planner. Raises `InputError` if that is above 1.
    """
    ratio *= sequence.speed_ratio
    is_fastest = bool(sequence.keyframes) and sequence.timing is Timing.FASTEST
    if is_fastest and ratio > 1.0:
        raise InputError(
            f"speed {ratio:g}: the sequence is planned as fast as the limits allow; 1 is the most",
            path=sequence.path,
        )
    duration_s, span_s = sequence.fit_duration_s, sequence.loop_span_s
    return replace(
        sequence,
        speed_ratio=ratio if is_fastest else 1.0,
        keyframes=sequence.keyframes
        if is_fastest or ratio == 1.0
        else tuple(_frame(frame, ratio) for frame in sequence.keyframes),
        loop_span_s=None if span_s is None else (span_s[0] / ratio, span_s[1] / ratio),
        fit_duration_s=None if duration_s is None else duration_s / ratio,
        smooth_s=sequence.smooth_s if is_fastest else sequence.smooth_s / ratio,
        tracks=tuple(at_speed(track, ratio) for track in sequence.tracks),
        play=tuple(_step(step, ratio) for step in sequence.play),
        layers=tuple(_layer(layer, ratio) for layer in sequence.layers),
        events=tuple(_cue(cue, ratio) for cue in sequence.events),
        beats_s=tuple(beat_s / ratio for beat_s in sequence.beats_s),
    )


def _cue(cue: Cue, ratio: float) -> Cue:
    style = replace(cue.style, speed_ratio=cue.style.speed_ratio * ratio)
    return replace(cue, at_s=cue.at_s / ratio, style=style if cue.sound else cue.style)


def _frame(frame: Keyframe, ratio: float) -> Keyframe:
    at_s = None if frame.at_s is None else frame.at_s / ratio
    slopes = {name: ratio * slope for name, slope in frame.slope_deg_s.items()}
    return replace(frame, at_s=at_s, hold_s=frame.hold_s / ratio, slope_deg_s=slopes)


def _step(step: PlaylistStep, ratio: float) -> PlaylistStep:
    return replace(
        step,
        sequence=None if step.sequence is None else at_speed(step.sequence, ratio),
        pause_s=step.pause_s / ratio,
        move_s=None if step.move_s is None else step.move_s / ratio,
    )


def _layer(layer: Layer, ratio: float) -> Layer:
    return replace(
        layer,
        sequence=at_speed(layer.sequence, ratio),
        from_s=layer.from_s / ratio,
        to_s=None if layer.to_s is None else layer.to_s / ratio,
        fade_s=layer.fade_s / ratio,
    )
