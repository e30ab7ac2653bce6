"""An arm that swings without end on servos behind `./port`, and a wait for other processes."""

from __future__ import annotations

import time
from pathlib import Path

ROBOT = """\
robot: arm
buses: {main: {port: ./port, baud_bps: 115200, firmware: 370}}
joints:
  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
"""
SHOW = """\
sequence: swing
robot: arm.yaml
loop: forever
keyframes:
  - {at_s: 0, deg: {a: 0}}
  - {at_s: 1, deg: {a: 30}}
  - {at_s: 2, deg: {a: 0}}
"""
WAIT_S = 60.0


def write_show(folder):
    Path(folder, "arm.yaml").write_text(ROBOT)
    Path(folder, "swing.yaml").write_text(SHOW)


def until(is_met, what=lambda: ""):
    """Wait until a condition holds and return what it is; the time only bounds a failure."""
    end_s = time.monotonic() + WAIT_S
    while not (found := is_met()):
        assert time.monotonic() < end_s, f"not within {WAIT_S:g} s: {what()}"
        time.sleep(0.02)
    return found
