"""A small stage on disk: two joints, a sensor, four shows."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lss_motion.stage.load import load_stage

ROBOT = """\
robot: puppet
defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  neck: {id: 1, range_deg: [-90, 90]}
  jaw:  {id: 2, range_deg: [-90, 90]}
sensors:
  door: {id: 203, kind: GP2Y0A21YK0F}
"""

SHOW = (
    "sequence: {name}\nkeyframes:\n  - {{at_s: 0, deg: {start}}}\n  - {{at_s: {s}, deg: {end}}}\n"
)

STAGE = """\
stage: hall
robot: robot.yaml
shows: {idle: idle.yaml, hello: hello.yaml, scare: scare.yaml, sleep: sleep.yaml}
idle: idle
"""


@pytest.fixture
def kit(tmp_path):
    """Return functions that write the files of a stage and load it."""
    (tmp_path / "robot.yaml").write_text(ROBOT, "utf-8")
    for name, seconds, start, end in [
        ("idle", 4, {"neck": 0}, {"neck": 0}),
        ("hello", 2, {"neck": 0, "jaw": 0}, {"neck": 30, "jaw": 20}),
        ("scare", 1, {"jaw": 0}, {"jaw": 40}),
        ("sleep", 2, {"neck": 0, "jaw": 0}, {"neck": -30, "jaw": 0}),
    ]:
        text = SHOW.format(name=name, s=seconds, start=start, end=end).replace("'", "")
        (tmp_path / f"{name}.yaml").write_text(text, "utf-8")

    def write(more="", text=STAGE):
        path = tmp_path / "stage.yaml"
        path.write_text(text + more, "utf-8")
        return path

    def load(more="", text=STAGE):
        return load_stage(write(more, text))

    return SimpleNamespace(folder=tmp_path, write=write, load=load, stage=STAGE)
