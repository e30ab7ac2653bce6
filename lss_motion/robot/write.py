"""What was measured, into a robot file that a person wrote; all else in it stays as it is."""

from __future__ import annotations

import codecs
import os
import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.source_file import read_data, text_of
from lss_motion.yaml_edit import set_comment, set_values

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.robot.model import Robot


def write_response(
    path: Path,
    joint_name: str,
    values: Mapping[str, Any],
    comments: Sequence[str],
    *,
    output: Path | None = None,
) -> None:
    """Set fields of a joint's `response` in the robot file, or in a copy of it at `output`.

    `comments` stand above the joint, in place of those of the last time. The file is replaced at
    once or not at all. Raises `InputError` where the text cannot be changed alone, and where the
    changed file would say anything else than the old one but for these values.
    """
    data = read_data(path)
    text = text_of(data, path)
    changed = set_values(path, text, ("joints", joint_name, "response"), values)
    changed = set_comment(changed, ("joints", joint_name), f"{joint_name} identified", comments)
    mark = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
    _replace(path, mark + changed.encode("utf-8"), output or path, joint_name, values)


def _replace(
    path: Path, data: bytes, output: Path, joint_name: str, values: Mapping[str, Any]
) -> None:
    target = output.resolve()
    try:
        with NamedTemporaryFile(dir=target.parent, suffix=".yaml", delete=False) as temporary:
            temporary.write(data)
        made = Path(temporary.name)
        try:
            _check(path, load_robot(made), joint_name, values)
            shutil.copymode(path, made)
            os.replace(made, target)  # noqa: PTH105  (what is meant, by its name)
        finally:
            with suppress(FileNotFoundError):
                made.unlink()
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path=output) from error


def _check(path: Path, changed: Robot, joint_name: str, values: Mapping[str, Any]) -> None:
    """Refuse a change that changed more, or less, than it should."""
    robot = load_robot(path)
    joint = robot.joints[joint_name]
    wanted = replace(
        joint,
        response=replace(joint.response, **values),
        accel_max_deg_s2=changed.joints[joint_name].accel_max_deg_s2,  # It follows from the ramps.
    )
    expected = replace(robot, path=None, joints={**robot.joints, joint_name: wanted})
    if replace(changed, path=None) != expected:
        said = ", ".join(f"{key}: {value}" for key, value in values.items())
        raise InputError(
            f"joint {joint_name!r} is written in a way that cannot be changed here; add "
            f"`response: {{{said}}}` to it by hand",
            path=path,
        )
