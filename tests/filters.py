"""What the filter of a servo in EM0, wherever its steps fall, makes of the targets it receives."""

from __future__ import annotations

import numpy as np

FILTER_S = 0.02


def staircase(received, count, phase_s, end_s):
    """Return what a filter that steps at `phase_s` and every 20 ms from there makes of targets.

    `received`: `(instant in ns, target in degrees)`; the filter stands at 0.
    """
    value, values = 0.0, []
    for step in range(round((end_s - phase_s) / FILTER_S)):
        before = [deg for at_ns, deg in received if at_ns / 1e9 <= phase_s + step * FILTER_S]
        value += ((before[-1] if before else 0.0) - value) / count
        values.append(value)
    return np.array(values)


def felt(values, lag_s=0.02):
    """Return the accelerations of a horn that lags behind a staircase, as differences of 20 ms."""
    second = np.diff(values, 2, prepend=[0.0, 0.0]) / FILTER_S**2
    ratio, last, found = 1.0 - np.exp(-FILTER_S / lag_s), 0.0, []
    for one in second:
        last += ratio * (one - last)
        found.append(last)
    return np.array(found)
