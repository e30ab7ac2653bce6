"""When keyframes are due: which timing a file means, and its relative times made absolute."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.sequence.check import SAME_TIME_S
from lss_motion.sequence.model import Timing
from lss_motion.yaml_source import Problem

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from lss_motion.sequence.file import KeyframeEntry, TrackEntry

KEYFRAMES_MAX: Final = 10_000
"""Chosen: hours of lively show; cost grows with it, and a runaway export is noticed."""

TIME_MAX_S: Final = 86_400.0
"""Chosen: a day. A longer show is a loop, and a slip of the key is noticed."""


def has_times(content: TrackEntry) -> bool:
    """Return whether any keyframe says when it is due."""
    return any(_has_time(entry) for entry in content.keyframes)


def timing_of(content: TrackEntry) -> Timing:
    """Return the timing that the file asks for; without a word, keyframes with times decide."""
    if content.timing is not None:
        return Timing(content.timing)
    return Timing.AUTHORED if has_times(content) else Timing.FASTEST


def timing_problems(content: TrackEntry) -> Iterator[Problem]:
    """Yield where `timing`, `duration_s`, the times and the anchors contradict each other."""
    timing = timing_of(content)
    if timing is Timing.FIT and content.duration_s is None:
        yield Problem(("timing",), "timing: fit needs 'duration_s', the time that one pass takes")
    if timing is not Timing.FIT and content.duration_s is not None:
        yield Problem(
            ("duration_s",),
            f"duration_s ({content.duration_s:g}) belongs to timing: fit; add that, or remove it",
        )
    if timing is Timing.AUTHORED and not has_times(content) and len(content.keyframes) > 1:
        yield Problem(
            ("timing",),
            "timing: authored, but no keyframe has 'at_s' or 'after_s'; give them, or write "
            "timing: fastest",
        )
    for index, entry in enumerate(content.keyframes):
        if timing is Timing.FASTEST and _has_time(entry):
            key = "after_s" if entry.at_s is None else "at_s"
            yield Problem(
                ("keyframes", index, key),
                f"{key}: timing: fastest finds the times itself; remove it, or write timing: "
                "authored",
            )
        if entry.anchor and timing is not Timing.AUTHORED:
            yield Problem(
                ("keyframes", index, "anchor"),
                f"an anchor keeps an authored time, but timing is {timing}; remove it, or give "
                "times and write timing: authored",
            )


def absolute_times(
    entries: Sequence[KeyframeEntry], unread: Container[int]
) -> tuple[list[float | None], list[Problem]]:
    """Return the time of every keyframe, and what is wrong with the times.

    None stands for a time that cannot be known, because of that keyframe or of one before it.
    A time that meets the end of the keyframe before within rounding is exactly that end.
    """
    times_s: list[float | None] = []
    problems: list[Problem] = []
    end_s: float | None = 0.0
    for index, entry in enumerate(entries):
        before_s = times_s[-1] if times_s else None
        if index in unread:
            at_s = None
        else:
            at_s, found = _time(index, entry, before_s, end_s)
            problems += [Problem(("keyframes", index, key), reason) for key, reason in found]
        times_s.append(at_s)
        end_s = None if at_s is None else at_s + entry.hold_s
    return times_s, problems


def _has_time(entry: KeyframeEntry) -> bool:
    return entry.at_s is not None or entry.after_s is not None


def _time(
    index: int, entry: KeyframeEntry, before_s: float | None, end_s: float | None
) -> tuple[float | None, list[tuple[str, str]]]:
    """Return the time of one keyframe; `end_s` is when the one before ends, its hold included."""
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
    if end_s is not None and abs(at_s - end_s) < SAME_TIME_S:
        at_s = end_s
    return at_s, [(key, reason) for reason in _order_problems(key, at_s, before_s, end_s)]


def _order_problems(
    key: str, at_s: float, before_s: float | None, end_s: float | None
) -> Iterator[str]:
    if at_s > TIME_MAX_S:
        yield f"{key}: comes to {at_s:g} s, more than a day ({TIME_MAX_S:g} s)"
    if before_s is None or end_s is None:
        return
    if at_s <= before_s:
        yield f"{key}: times must increase, but this is {at_s:g} s after {before_s:g} s"
    elif at_s < end_s:
        yield (
            f"{key}: {at_s:g} s is before the end of the keyframe before, which is held until "
            f"{end_s:g} s; come later, or shorten its hold_s"
        )
