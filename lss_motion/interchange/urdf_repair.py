"""Mends what URDF files of hobby robots have wrong where forces are computed from them.

Inertias of zero, masses that are none or those of lead, efforts and velocities that no servo has,
and limits that coincide. The motion of this package depends on none of these but the limits; a
simulator of forces does. Every value that changes is a note, and nothing else of the text is
changed.
"""

from __future__ import annotations

import math
import struct
import xml.etree.ElementTree as ET
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import read_data
from lss_motion.interchange.urdf_joints import finite
from lss_motion.robot.servo_models import MASS_KG, STATIC_TORQUE_N_M
from lss_motion.robot.urdf import MESH_SUFFIX

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.interchange.urdf_joints import ImportNotes, ServoJoint
    from lss_motion.robot.model import ServoModel
    from lss_motion.robot.urdf import UrdfElement, UrdfFile

    FloatArray = NDArray[np.float64]

MASS_ASSUMED_KG: Final = 0.06
"""Assumption where a link that moves has no mass and the mass of the servo is not known."""
DENSITY_MAX_KG_M3: Final = 8000.0
"""Chosen: no link is denser than a block of steel."""
DENSITY_KG_M3: Final = 1200.0
"""Chosen: what a printed part with a servo in it weighs, about that of solid plastic."""
TOTAL_RATIO: Final = 4.0
"""Chosen: a robot that weighs this many times its servos is named; a walking one weighs twice."""
ROUND_M: Final = 0.03
"""Assumption: the radius of a link of which the file has no shape that can be measured."""
MESH_MAX_BYTES: Final = 64_000_000
PARENTS_MAX: Final = 3
"""`package://name/meshes/a.stl` is looked for beside the file and in so many folders above."""


class _Solid(Struct, frozen=True):
    """A box around a shape of a link, in metres: `size_m` along x, y and z of its own frame."""

    size_m: tuple[float, float, float]
    name: str

    @property
    def volume_m3(self) -> float:
        return math.prod(self.size_m)

    def inertia(self, mass_kg: float) -> tuple[float, float, float]:
        """Return ixx, iyy and izz of a solid box."""
        x, y, z = (size * size for size in self.size_m)
        return (
            mass_kg * (y + z) / 12.0,
            mass_kg * (x + z) / 12.0,
            mass_kg * (x + y) / 12.0,
        )


def repaired(
    data: bytes,
    file: UrdfFile,
    servos: Mapping[str, ServoJoint],
    model: ServoModel,
    notes: ImportNotes,
) -> str | None:
    """Return the text with what was mended; None: nothing was. `servos` by their name in the file.

    Comments and the order of the elements stay.
    """
    # `UrdfFile` has read it and refuses document types, and with them entities.
    builder = ET.TreeBuilder(insert_comments=True)
    root = ET.fromstring(data, ET.XMLParser(target=builder))  # noqa: S314
    before = ET.tostring(root)
    for joint in root.findall("joint"):
        if (servo := servos.get(joint.get("name", "").strip())) is not None:
            _mend_limits(joint, servo, model, notes)
    links = {link.get("name", "").strip(): link for link in root.findall("link")}
    _mend_masses(file, links, servos, model, notes)
    if ET.tostring(root) == before:
        return None
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n'


def _mend_limits(
    joint: ET.Element, servo: ServoJoint, model: ServoModel, notes: ImportNotes
) -> None:
    """Let the limits of a joint be those of its servo; what differs was noted with its joint."""
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    low, high = (math.radians(angle) for angle in servo.range_deg)
    speed = math.radians(servo.speed_max_deg_s)
    for key, value in (("lower", low), ("upper", high)):
        if joint.get("type") != "continuous" and not _is_near(limit.get(key), value):
            limit.set(key, f"{value:.6g}")
    if not _is_near(limit.get("velocity"), speed):
        limit.set("velocity", f"{speed:.6g}")
    torque = STATIC_TORQUE_N_M.get(model.name)
    given = finite(limit.get("effort"))
    if torque is None:
        return
    if given is None or given <= 0.0:
        notes.add(servo.name, f"has no effort; an {model.name} holds {torque:g} N·m")
    elif given > torque:
        notes.add(servo.name, f"its effort is {given:g} N·m; an {model.name} holds {torque:g}")
    else:
        return
    limit.set("effort", f"{torque:g}")


def _is_near(text: str | None, value: float) -> bool:
    """Return whether a number stands for `value` to within the steps in which it was rounded."""
    given = finite(text)
    return given is not None and abs(given - value) <= math.radians(0.1)


def _mend_masses(
    file: UrdfFile,
    links: Mapping[str, ET.Element],
    servos: Mapping[str, ServoJoint],
    model: ServoModel,
    notes: ImportNotes,
) -> None:
    own_kg = MASS_KG.get(model.name, MASS_ASSUMED_KG)
    moved = {joint.urdf.child for joint in servos.values()}
    sum_kg = 0.0
    for name in file.order:
        solid = _solid(file, file.links[name])
        inertial = links[name].find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        given = None if mass is None else finite(mass.get("value"))
        mass_kg = given or 0.0
        if mass_kg <= 0.0:
            if name not in moved and inertial is None:
                continue  # A frame, or a part that weighs nothing beside what carries it.
            mass_kg = own_kg
            notes.add(name, f"has no mass; {mass_kg:g} kg are assumed, those of a servo")
        elif solid.volume_m3 > 0.0 and mass_kg / solid.volume_m3 > DENSITY_MAX_KG_M3:
            light_kg = float(f"{DENSITY_KG_M3 * solid.volume_m3:.3g}")
            notes.add(
                name,
                f"{mass_kg:g} kg in {solid.name} is denser than steel; {light_kg:g} kg are assumed",
            )
            mass_kg = light_kg
        sum_kg += mass_kg
        _write_mass(links[name], mass_kg, given)
        _mend_inertia(links[name], name, mass_kg, solid, notes, is_new=mass_kg != given)
    if sum_kg > TOTAL_RATIO * own_kg * len(servos):
        ratio = sum_kg / (own_kg * len(servos))
        notes.add(
            "",
            f"all links weigh {sum_kg:.3g} kg, {ratio:.0f} times their servos: weigh the robot; no "
            f"mass was changed for that",
        )


def _write_mass(link: ET.Element, mass_kg: float, given: float | None) -> None:
    if mass_kg == given:
        return
    inertial = link.find("inertial")
    if inertial is None:
        inertial = ET.SubElement(link, "inertial")
    mass = inertial.find("mass")
    if mass is None:
        mass = ET.SubElement(inertial, "mass")
    mass.set("value", f"{mass_kg:g}")


def _mend_inertia(
    link: ET.Element, name: str, mass_kg: float, solid: _Solid, notes: ImportNotes, *, is_new: bool
) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    inertia = inertial.find("inertia")
    reason = "follows its new mass" if is_new else _inertia_fault(inertia, mass_kg)
    if reason is None:
        return
    if inertia is None:
        inertia = ET.SubElement(inertial, "inertia")
    for key, value in zip(("ixx", "iyy", "izz"), solid.inertia(mass_kg), strict=True):
        inertia.set(key, f"{value:.4g}")
    for key in ("ixy", "ixz", "iyz"):
        inertia.set(key, "0")
    notes.add(name, f"its inertia {reason}; that of {solid.name} is written")


def _inertia_fault(inertia: ET.Element | None, mass_kg: float) -> str | None:
    """Return why no body has this inertia; None: one can have it."""
    if inertia is None:
        return "is missing"
    values = {key: finite(inertia.get(key)) or 0.0 for key in ("ixx", "iyy", "izz")}
    mixed = {key: finite(inertia.get(key)) or 0.0 for key in ("ixy", "ixz", "iyz")}
    if not any(values.values()):
        return "is 0"
    matrix = np.array(
        [
            [values["ixx"], mixed["ixy"], mixed["ixz"]],
            [mixed["ixy"], values["iyy"], mixed["iyz"]],
            [mixed["ixz"], mixed["iyz"], values["izz"]],
        ]
    )
    one, two, three = np.linalg.eigvalsh(matrix)
    if one <= 0.0:
        return "is not positive"
    # Of three moments of a body, two together are never less than the third.
    if one + two < three * (1.0 - 1e-6):
        return "is that of no body"
    if three > mass_kg:  # A body of that mass with a radius of gyration of one metre.
        return "is that of a body of metres"
    return None


def _solid(file: UrdfFile, link: UrdfElement) -> _Solid:
    """Return the largest box around one shape of a link; a ball where none can be measured."""
    found = []
    for tag in ("collision", "visual"):
        for part in link.of(tag):
            geometry = part.one("geometry")
            if geometry is not None and geometry.children:
                size = _size_m(file, geometry.children[0])
                if size is not None and min(size) > 0.0:
                    found.append(_Solid(size, f"its {geometry.children[0].tag}"))
    if not found:
        side = 2.0 * ROUND_M
        return _Solid((side, side, side), f"a block of {1000.0 * side:g} mm, which is assumed,")
    return max(found, key=lambda solid: solid.volume_m3)


def _size_m(file: UrdfFile, shape: UrdfElement) -> tuple[float, float, float] | None:
    try:
        match shape.tag:
            case "box":
                return file.vector(shape, "size", (0.0, 0.0, 0.0))
            case "sphere":
                side = 2.0 * file.number(shape, "radius", 0.0)
                return side, side, side
            case "cylinder":
                side = 2.0 * file.number(shape, "radius", 0.0)
                return side, side, file.number(shape, "length", 0.0)
            case "mesh":
                scale = file.vector(shape, "scale", (1.0, 1.0, 1.0))
                size = _mesh_size(file.path, shape.attributes.get("filename", ""))
                if size is None:
                    return None
                x, y, z = (abs(a * b) for a, b in zip(size, scale, strict=True))
                return x, y, z
            case _:
                return None
    except InputError:  # A shape that cannot be drawn has its note where it is drawn.
        return None


def _mesh_size(path: Path, named: str) -> tuple[float, float, float] | None:
    """Return the extent of a mesh file in its own unit; None: it cannot be found or measured."""
    rest = PurePosixPath(named.rpartition("://")[2].replace("\\", "/"))
    if rest.is_absolute() or ".." in rest.parts or rest.suffix.lower() != MESH_SUFFIX:
        return None
    choices = [rest, PurePosixPath(*rest.parts[1:])]
    folders = [path.resolve().parent, *list(path.resolve().parents)[1 : PARENTS_MAX + 1]]
    files = [folder / one for folder in folders for one in choices]
    mesh = next((one for one in files if one.is_file()), None)
    if mesh is None:
        return None
    points = _stl_points(read_data(mesh, MESH_MAX_BYTES))
    if points is None or len(points) == 0 or not np.isfinite(points).all():
        return None
    x, y, z = (float(one) for one in points.max(axis=0) - points.min(axis=0))
    return x, y, z


def _stl_points(data: bytes) -> FloatArray | None:
    """Return the corners of the triangles of an STL file, (n, 3)."""
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        rows = np.frombuffer(data, dtype=np.uint8, offset=84).reshape(-1, 50)[:, 12:48]
        return np.ascontiguousarray(rows).view("<f4").reshape(-1, 3).astype(np.float64)
    words = data.split()
    try:
        found = [
            [float(number) for number in words[index + 1 : index + 4]]
            for index, word in enumerate(words)
            if word == b"vertex"
        ]
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        return None
