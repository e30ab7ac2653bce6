"""`<robot>.learnt.yaml`: what the program learnt about a robot, kept beside its robot file.

The robot file stays its author's. This file is the program's: it is written as a whole, a person
may read it, and without it everything is learnt again. Each joint has a hash of what its robot file
says about it (`settings_hash`); what was learnt of other settings does not count.

`lag_s` and `speed_ratio` are findings for a person: no plan and no player uses them. The lag is
that of a slow move, in which readings that scatter by 0.2 deg (FACTS.md E7) hide 7 ms at 30 deg/s,
a third of what is assumed of a servo; the player measures it within seconds of a show. And the same
files give the same program, whatever has been learnt. `identify` measures `response`, and writes it
into the robot file if its user wants that.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import TYPE_CHECKING, Annotated, Any, Final

from lss_motion.files.keys import Check, Field, FileModel, Name, Text, json_schema
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.validation import validate
from lss_motion.files.yaml_source import read_yaml
from lss_motion.robot.model import learnt_path

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from lss_motion.robot.model import Joint, Robot


FIRST_LINE: Final = "# lss_motion learnt 1"
"""By it a file is known as one of this kind (`files.output.Kind`)."""
HASH_CHARS: Final = 16
PLAIN: Final = re.compile(r"[A-Za-z]\w*|\d{4}-\d\d-\d\d", re.ASCII)
WORDS: Final = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")
"""Text that needs no quotes, and words that do: they mean something else to some YAML readers."""
LAG_MAX_S: Final = 10.0
"""No servo is later than this; a larger number is a damaged file."""

ABOUT: Final = """\
# What lss-play learnt about the robot in {name}. The program writes this file; remove it, and
# the careful run is offered again.
#   settings       hash of what the robot file says of the joint; when that changes, the rest of
#                  its entry no longer counts
#   careful_run    day of the last careful run, with the direction and the scale (the units) of the
#                  servo as expected, its lag in seconds, and its speed in units of the expected one
#   sound_offset_s sounds sound so much later than the show (keys , . and k of lss-play)
#   completed_run  day on which a show with this joint was played to its end for the first time
"""


def _check_day(text: str) -> str:
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", text):
        raise ValueError("must be a day, such as 2026-11-23")
    return text


def _check_hash(text: str) -> str:
    if not re.fullmatch(f"[0-9a-f]{{{HASH_CHARS}}}", text):
        raise ValueError(f"must be a hash of {HASH_CHARS} characters, 0 to 9 and a to f, in quotes")
    return text


Day = Annotated[Text, Check(_check_day)]


class LearntJoint(FileModel):
    """What was learnt about one joint."""

    settings: Annotated[Text, Check(_check_hash)] = Field(
        description="hash of what the robot file says of the joint"
    )
    careful_run: Day | None = Field(
        default=None, description="day of the last careful run without fault"
    )
    direction_ok: bool | None = Field(
        default=None, description="whether it turned as it was commanded"
    )
    scale_ok: bool | None = Field(
        default=None, description="whether its servo has the units of its model"
    )
    lag_s: float | None = Field(
        default=None, ge=-LAG_MAX_S, le=LAG_MAX_S, description="lag of the horn, in seconds"
    )
    speed_ratio: float | None = Field(
        default=None, ge=0.0, le=100.0, description="its speed in units of the expected one"
    )
    completed_run: Day | None = Field(
        default=None,
        description="day on which a show with it was played to its end for the first time",
    )


class Learnt(FileModel):
    """What was learnt about the joints of one robot."""

    robot: Name = Field(description="name of the robot")
    sound_offset_s: float | None = Field(
        default=None,
        ge=-2.0,
        le=2.0,
        description="sounds sound so much later than the show, found by ear (keys , . and k)",
    )
    joints: dict[Name, LearntJoint] = Field(
        default_factory=dict, description="what was learnt, by the name of the joint"
    )

    def of(self, joint: Joint) -> LearntJoint:
        """Return what was learnt about a joint with its present settings."""
        settings = settings_hash(joint)
        kept = self.joints.get(joint.name)
        return kept if kept is not None and kept.settings == settings else _blank(settings)

    def updated(self, joint: Joint, **values: object) -> Learnt:
        """Return this with values of one joint, in place of those that it had."""
        changed = self.of(joint).changed(**values)
        return self.changed(joints={**self.joints, joint.name: changed})

    def without(self, joint: Joint) -> Learnt:
        """Return this without what was learnt about a joint."""
        rest = {name: kept for name, kept in self.joints.items() if name != joint.name}
        return self.changed(joints=rest)

    def has_completed(self, joints: Iterable[Joint]) -> bool:
        """Return whether each joint, with its present settings, has been in a completed show."""
        return all(self.of(joint).completed_run is not None for joint in joints)


def _blank(settings: str) -> LearntJoint:
    return LearntJoint(settings=settings)


def settings_hash(joint: Joint) -> str:
    """Return the hash of what decides where a joint moves, and how fast.

    `response` and the thresholds of faults are not part of it: they change no limit and no target.
    """
    told = [
        joint.servo_id,
        joint.bus,
        joint.model.name,
        str(joint.model.units),
        joint.position_min_deg,
        joint.position_max_deg,
        joint.speed_max_deg_s,
        joint.accel_max_deg_s2,
        joint.direction,
        joint.zero_deg,
        joint.turns,
        sorted(joint.settings.items()),
        sorted(joint.stored.items()),
    ]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:HASH_CHARS]


def load_learnt(robot: Robot) -> Learnt:
    """Return what is known about a robot; nothing if there is no file.

    Raises `InputError` with the line of each mistake of a damaged file.
    """
    assert robot.path is not None
    path = learnt_path(robot.path)
    if not path.exists():
        return Learnt(robot=robot.name)
    source = read_yaml(path)
    content, problems, _ = validate(Learnt, source)
    if content is None or problems:
        raise source.error(problems)
    return content


def learnt_text(learnt: Learnt, robot_name: str) -> str:
    """Return the content of the file; `robot_name` is the name of the robot file."""
    lines = [
        FIRST_LINE,
        ABOUT.format(name=robot_name),
        f"robot: {_scalar(learnt.robot)}",
    ]
    if learnt.sound_offset_s is not None:
        lines.append(f"sound_offset_s: {_scalar(learnt.sound_offset_s)}")
    lines.append("joints:")
    for name, joint in learnt.joints.items():
        lines.append(f"  {_scalar(name)}:")
        values = joint.known()
        lines += [f"    {key}: {_scalar(value)}" for key, value in values.items()]
    if not learnt.joints:
        lines[-1] += " {}"
    return "\n".join(lines) + "\n"


def _scalar(value: object) -> str:
    """Return a value as YAML: text that could be something else in quotes, as JSON writes it."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str) and PLAIN.fullmatch(value) and value.lower() not in WORDS:
        return value
    return json.dumps(value, ensure_ascii=False)


def save_learnt(learnt: Learnt, robot: Robot) -> Path:
    """Write the file of a robot; return its path.

    Joints that the robot no longer has are left out. Raises `InputError` where the file cannot be
    written, or another kind of file has its name.
    """
    assert robot.path is not None
    path = learnt_path(robot.path)
    require_outputs(
        [Output(path, OutputKind.LEARNT)], sources=[robot.path], remedy="move it to another place"
    )
    kept = {name: joint for name, joint in learnt.joints.items() if name in robot.joints}
    text = learnt_text(learnt.changed(joints=kept), robot.path.name)
    write_output(path, text)
    return path


def learnt_schema() -> dict[str, Any]:
    """Return the JSON Schema of a file of learnt values."""
    return json_schema(Learnt)
