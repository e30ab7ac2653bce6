"""When the frames of a device sound, on the clock of this computer.

The crystal of a sound device is 20 to 100 ppm off, and the driver states the time of each block
with a jitter of up to milliseconds. So frame numbers are fitted against stated instants over
`WINDOW_S`. A device that does not run at its rate, or that skipped frames, is noticed.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from lss_motion.units import NS_PER_S

WINDOW_S: Final = 60.0
POINT_S: Final = 0.25
"""One point is kept for each span of this length: the median of its blocks."""
DAMPING_S2: Final = 20.0
"""At first the jitter must not be taken for a drift: the slope is damped, by a third after 5 s and
by 6 % after 10 s. Chosen for a jitter of 0.45 ms and a drift of 100 ppm."""
SLOPE_MAX_RATIO: Final = 300e-6
"""No crystal is further off."""
WRONG_LEAST_S: Final = 3.0
WRONG_RATIO: Final = 2e-3
"""A device further off than this over `WRONG_LEAST_S` has no clock to follow. Measured elsewhere:
a device at 0.91 of its rate."""
SKIP_S: Final = 0.005
SKIP_POINTS: Final = 2
"""So many points in a row that far from the fit: frames were skipped."""
SETTLED_S: Final = 1.0
"""What a driver states for its first blocks may be off by a block (measured: 21 ms of JACK); the
fit has left such statements after this time: three points, and the one that they are seen in."""


class DeviceClock:
    """Fits the instants at which frames sound. Frames count from 0 at the first block."""

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._points: deque[tuple[float, float]] = deque(maxlen=round(WINDOW_S / POINT_S))
        """Seconds by frames, and how much later than that they sound, in seconds."""
        self._recent: deque[tuple[float, float]] = deque(maxlen=round(WRONG_LEAST_S / POINT_S))
        self._span: list[tuple[float, float]] = []
        self._origin_ns: int | None = None
        self._offset_s = self._slope = 0.0
        self._middle_s = 0.0
        self._astray = 0
        self.skips = 0
        """How often the device has skipped frames."""
        self.wrong_ratio: float | None = None
        """Rate of a device that does not run at the one it states, relative to it."""

    def take(self, frame: int, heard_ns: int) -> None:
        """Note that the driver states `heard_ns` for the sound of `frame`."""
        if self._origin_ns is None:
            self._origin_ns = heard_ns
        by_frames_s = frame / self._rate_hz
        late_s = (heard_ns - self._origin_ns) / NS_PER_S - by_frames_s
        if not self._points and not self._span:
            self._offset_s, self._slope, self._middle_s = late_s, 0.0, by_frames_s
        self._span.append((by_frames_s, late_s))
        if by_frames_s - self._span[0][0] >= POINT_S:
            self._close_span()

    def note_dropout(self) -> None:
        """Note that the driver reports a dropout: one point off the fit is a skip now."""
        self._astray = SKIP_POINTS - 1
        self._span.clear()

    def heard_ns(self, frame: float) -> float:
        """Return when `frame` sounds."""
        assert self._origin_ns is not None, "no block yet"
        by_frames_s = frame / self._rate_hz
        late_s = self._offset_s + self._slope * (by_frames_s - self._middle_s)
        return self._origin_ns + (by_frames_s + late_s) * NS_PER_S

    @property
    def is_known(self) -> bool:
        return self._origin_ns is not None

    def is_settled(self, frame: float) -> bool:
        """Return whether the first statements of the driver count no more at `frame`."""
        return bool(self._points) and frame >= SETTLED_S * self._rate_hz

    @property
    def ns_per_frame(self) -> float:
        return NS_PER_S * (1.0 + self._slope) / self._rate_hz

    @property
    def rate_ratio(self) -> float:
        """Rate of the device relative to its nominal one, by the clock of this computer."""
        return 1.0 / (1.0 + self._slope)

    def _close_span(self) -> None:
        at_s, late_s = (float(value) for value in np.median(np.array(self._span), axis=0))
        self._span.clear()
        self._judge_rate(at_s, late_s)
        if self.wrong_ratio is not None:
            return
        predicted_s = self._offset_s + self._slope * (at_s - self._middle_s)
        is_astray = bool(self._points) and abs(late_s - predicted_s) > SKIP_S
        self._astray = self._astray + 1 if is_astray else 0
        if self._astray >= SKIP_POINTS:
            self._astray = 0
            self.skips += 1
            self._points.clear()
        elif is_astray:
            return
        self._points.append((at_s, late_s))
        self._fit()

    def _judge_rate(self, at_s: float, late_s: float) -> None:
        """Notice a device that is slow or fast all the time; skipped frames are single steps."""
        self._recent.append((at_s, late_s))
        if len(self._recent) == self._recent.maxlen:
            steps_s = np.diff(np.array(self._recent), axis=0)
            drift = float(np.median(steps_s[:, 1]) / np.median(steps_s[:, 0]))
            if abs(drift) <= WRONG_RATIO:
                self.wrong_ratio = None
                return
            self.wrong_ratio = 1.0 / (1.0 + drift)
            self._points.clear()
            self._slope, self._middle_s, self._offset_s = drift, at_s, late_s

    def _fit(self) -> None:
        points = np.array(self._points)
        times_s, lates_s = points[:, 0], points[:, 1]
        self._middle_s, self._offset_s = float(times_s.mean()), float(lates_s.mean())
        away_s = times_s - self._middle_s
        slope = float((away_s * lates_s).sum() / ((away_s * away_s).sum() + DAMPING_S2))
        self._slope = max(-SLOPE_MAX_RATIO, min(slope, SLOPE_MAX_RATIO))
