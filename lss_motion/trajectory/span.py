"""A sequence of which a part is looped: what leads in, the part again and again, what leads out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.sequence.model import Sequence
    from lss_motion.trajectory.model import Trajectory

    FloatArray = NDArray[np.float64]

SEAM_DEG: Final = 0.001
"""How far a joint may be at the end of the part from where it is at its beginning. Chosen: a tenth
of the finest unit of a servo; keys that are rounded to 1e-5 deg stay far below."""

SEAM_DEG_S: Final = 0.5
"""The same for its speed. Chosen: half of what counts as seamless, 1 deg/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """A pass that is a stretch of one pass of `whole`, joints in motion at its ends."""

    whole: Trajectory
    from_s: float
    to_s: float

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        return (self.whole,)

    @property
    def seams_s(self) -> FloatArray:
        return np.zeros(0)

    @property
    def duration_s(self) -> float:
        return self.to_s - self.from_s

    @property
    def knots_s(self) -> FloatArray:
        knots_s = self.whole.first.knots_s
        inner_s = knots_s[(knots_s > self.from_s) & (knots_s < self.to_s)]
        return np.concatenate([[0.0], inner_s - self.from_s, [self.duration_s]])

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, joints), as every pass does."""
        times_s = np.asarray(times_s, dtype=np.float64)
        inside_s = np.clip(times_s, 0.0, self.duration_s)
        values = self.whole.sample(self.from_s + inside_s, order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values


def looped_span(sequence: Sequence, whole: Trajectory) -> Trajectory:
    """Return `whole`, one pass of all keyframes of `sequence`, with its `loop_span_s` looped.

    Raises `InputError` where the joints do not end the part as they began it, in motion too.
    """
    assert sequence.loop_span_s is not None
    authored_s = np.array([0.0, *(mark.authored_s or 0.0 for mark in whole.marks)])
    planned_s = np.array([0.0, *(mark.planned_s for mark in whole.marks)])
    from_s, to_s = np.interp(sequence.loop_span_s, authored_s, planned_s).tolist()
    if not from_s < to_s:
        reason = f"the part that is looped lies after the end, at {whole.duration_s:.3f} s"
        raise InputError(reason, path=sequence.path)
    _check_seam(sequence, whole, from_s, to_s)
    if sequence.loop == 1:
        return whole
    skipped_s = 0.0 if sequence.loop is None else (sequence.loop - 1) * (to_s - from_s)
    return replace(
        whole,
        first=Span(whole=whole, from_s=0.0, to_s=to_s),
        middle=Span(whole=whole, from_s=from_s, to_s=to_s),
        last=Span(whole=whole, from_s=from_s, to_s=whole.duration_s),
        loop=sequence.loop,
        is_periodic=True,
        marks=tuple(
            replace(mark, planned_s=mark.planned_s + (skipped_s if mark.planned_s > to_s else 0.0))
            for mark in whole.marks
            if mark.planned_s <= to_s or sequence.loop is not None
        ),
    )


def _check_seam(sequence: Sequence, whole: Trajectory, from_s: float, to_s: float) -> None:
    ends_s = np.array([from_s, to_s])
    for order, allowed, unit in ((0, SEAM_DEG, "deg"), (1, SEAM_DEG_S, "deg/s")):
        first, last = whole.sample(ends_s, order)
        worst = int(np.argmax(np.abs(last - first)))
        if abs(last[worst] - first[worst]) > allowed:
            raise InputError(
                f"the part that is looped must end as it begins, but joint "
                f"{whole.joints[worst]!r} is at {first[worst]:.3f} {unit} at its beginning and at "
                f"{last[worst]:.3f} {unit} at its end",
                path=sequence.path,
            )
