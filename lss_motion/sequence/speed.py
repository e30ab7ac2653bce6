"""A sequence at another speed: every time in it divided by its `speed_ratio`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.sequence.model import Timing

if TYPE_CHECKING:
    from lss_motion.sequence.model import Keyframe, Layer, Sequence, Step


def at_speed(sequence: Sequence, ratio: float = 1.0) -> Sequence:
    """Return the sequence with `ratio` and its own `speed_ratio` put into its times.

    What is left to a planner is the `speed_ratio` of a sequence whose timing is `fastest`: at
    most 1, else `InputError`.
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
        tracks=tuple(at_speed(track, ratio) for track in sequence.tracks),
        play=tuple(_step(step, ratio) for step in sequence.play),
        layers=tuple(_layer(layer, ratio) for layer in sequence.layers),
        events=tuple(replace(cue, at_s=cue.at_s / ratio) for cue in sequence.events),
    )


def _frame(frame: Keyframe, ratio: float) -> Keyframe:
    at_s = None if frame.at_s is None else frame.at_s / ratio
    return replace(frame, at_s=at_s, hold_s=frame.hold_s / ratio)


def _step(step: Step, ratio: float) -> Step:
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
