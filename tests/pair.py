"""Two joints, pan and tilt, and a show in which both nod, as files."""

from __future__ import annotations

ROBOT = """
robot: pair
joints:
  pan:  {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-40, 60], speed_max_deg_s: 180, accel_max_deg_s2: 600}
poses:
  home: {pan: 0, tilt: 0}
"""
NOD = """
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, pose: home}
  - {at_s: 1, deg: {pan: 40, tilt: 30}}
  - {at_s: 2, pose: home}
"""
