"""A URDF or xacro file → a robot file, with the URDF file as its figure.

Its revolute and continuous joints become joints with a servo each; joints that mimic another one
turn in the picture only. What the file does not say, and what no servo can do, gets a value that is
stated: each such value is a line of `ImportedRobot.notes`, and a comment of the robot file.
`urdf_repair` mends masses, inertias and efforts for programs that compute forces; `urdf_legs` finds
legs.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from msgspec import Struct

from lss_motion.errors import InputError, install_command
from lss_motion.files.keys import TEXT_MAX_CHARS
from lss_motion.files.source import read_data
from lss_motion.files.texts import counted
from lss_motion.interchange.urdf_joints import (
    ACCEL_DEG_S2,
    NOT_IN_NAMES,
    ImportNotes,
    ServoJoint,
    servo_joints,
)
from lss_motion.interchange.urdf_legs import LegFinder
from lss_motion.interchange.urdf_repair import repaired
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.robot.urdf import URDF_MAX_BYTES, UrdfFile

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lss_motion.robot.urdf import UrdfElement


class ImportedRobot(Struct, frozen=True, kw_only=True):
    """What was made of a URDF file, as texts of files.

    `urdf` is the file that the robot file names: None if that is the file which was read. `gait` is
    None if no legs were recognised.
    """

    robot: str
    urdf: str | None
    gait: str | None
    joints: tuple[ServoJoint, ...]
    notes: tuple[str, ...]


def imported_robot(
    path: Path, output: Path, *, model: str = "LSS-ST1", may_run: bool = False
) -> ImportedRobot:
    """Return the files that are made of the URDF or xacro file at `path`, for a robot at `output`.

    All servos are of `model`. A xacro file is expanded only if `may_run`: Python evaluates its
    expressions. Raises `InputError` with the line for a file that is no tree of links and joints,
    and for one in which no joint turns.
    """
    data = read_data(path, URDF_MAX_BYTES)
    is_xacro = ".xacro" in path.suffixes or b"<xacro:" in data
    if is_xacro:
        data = _expanded(path, may_run=may_run)
    file = UrdfFile(path, data)
    notes = ImportNotes()
    servos = servo_joints(file, SERVO_MODELS[model], notes)
    text = repaired(data, file, {one.urdf.name: one for one in servos}, SERVO_MODELS[model], notes)
    folder = output.absolute().parent.resolve()
    is_below = path.resolve().is_relative_to(folder)
    if text is None and (is_xacro or not is_below):
        text = data.decode("utf-8")
    picture = output.with_suffix(".urdf").name if text is not None else ""
    if not picture:
        picture = path.resolve().relative_to(folder).as_posix()
    if text is not None and not is_below and any(map(_has_mesh, file.links.values())):
        notes.add("", f"meshes are drawn from below {folder} only: copy their folder there")
    finder = LegFinder(file, servos)
    gait = finder.gait(output.stem, output.name)
    for note in finder.notes:
        notes.add("", note)
    lines = notes.lines()
    given = file.root.attributes.get("name", "").strip() or output.stem
    name = NOT_IN_NAMES.sub("_", given)[:TEXT_MAX_CHARS]
    return ImportedRobot(
        robot=_robot_text(name, path.name, model, servos, picture, lines),
        urdf=text,
        gait=gait,
        joints=servos,
        notes=lines,
    )


def _expanded(path: Path, *, may_run: bool) -> bytes:
    """Return the URDF text of a xacro file."""
    if not may_run:
        raise InputError(
            "is a xacro file: Python evaluates its expressions, and it may read other files. If "
            "you trust it, add --allow-run",
            path=path,
        )
    try:
        from xacrodoc import XacroDoc
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "xacrodoc":
            raise
        raise InputError(f"is a xacro file: {install_command('urdf')}", path=path) from None
    try:
        document = XacroDoc.from_file(str(path))
        return str(document.to_urdf_string()).encode("utf-8")
    # Expressions of the file raise whatever Python does.
    except Exception as error:
        first = str(error).strip().partition("\n")[0] or type(error).__name__
        raise InputError(f"xacro cannot expand it: {first}", path=path) from error


def _has_mesh(link: UrdfElement) -> bool:
    shapes = (visual.one("geometry") for visual in link.of("visual"))
    return any(shape is not None and shape.one("mesh") is not None for shape in shapes)


def _robot_text(
    name: str,
    source: str,
    model: str,
    servos: tuple[ServoJoint, ...],
    picture: str,
    notes: tuple[str, ...],
) -> str:
    width = max(len(one.name) for one in servos) + 1
    rows = [
        f"  {one.name + ':':{width}} {{id: {number}, range_deg: [{one.range_deg[0]:g}, "
        f"{one.range_deg[1]:g}], speed_max_deg_s: {one.speed_max_deg_s:g}"
        f"{'' if one.ratio == 1.0 else f', ratio: {one.ratio:g}'}}}"
        for number, one in enumerate(servos, 1)
    ]
    return "\n".join(
        [
            f"# {counted(servos, 'joint')} of {source}. What was not in it, or could not stay:",
            *(f"# - {note}" for note in notes),
            "",
            f"robot: {name}",
            "",
            "buses:",
            '  main: {port: "sim://", baud_bps: 115200}      # write your port, as /dev/ttyUSB0',
            "",
            "defaults:",
            f"  model: {model}",
            f"  accel_max_deg_s2: {ACCEL_DEG_S2:g}",
            "",
            "joints:",
            *rows,
            "",
            *_urdf_key(picture, {one.name: one.urdf.name for one in servos}),
            "",
        ]
    )


def _urdf_key(picture: str, names: Mapping[str, str]) -> list[str]:
    other = {name: urdf for name, urdf in names.items() if name != urdf}
    if not other:
        return [f"urdf: {{file: {_quoted(picture)}}}"]
    return [
        "urdf:",
        f"  file: {_quoted(picture)}",
        "  joints:",
        *(f"    {name}: {_quoted(urdf)}" for name, urdf in other.items()),
    ]


def _quoted(text: str) -> str:
    if re.fullmatch(r"[A-Za-z][\w./\-]*", text):
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
