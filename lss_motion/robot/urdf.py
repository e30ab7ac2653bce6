"""A URDF file as links and joints (`UrdfFile`), and its picture (`urdf_figure`).

Strict: a number that is none, a frame without a parent, a link with two parents or a joint that
slides under a servo is refused with its line. A visual part that cannot be drawn is a note: the
robot moves all the same. Nothing outside of the folder of the robot file is
read, and no document type (and with it no entity) is accepted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final, Literal, NoReturn
from xml.parsers import expat

from lss_motion.errors import InputError
from lss_motion.files.source import read_data
from lss_motion.files.texts import known_names
from lss_motion.robot.figure import (
    ORIGIN,
    UPRIGHT,
    Figure,
    FigureLink,
    Rotation,
    Shape,
    Vector,
    turned,
    unit_vector,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from lss_motion.robot.model import UrdfSource

MM_PER_M: Final = 1000.0
LINKS_MAX: Final = 500
"""As of `figure` in a robot file."""
DEPTH_MAX: Final = 32
"""A URDF file is 5 deep; extensions of simulators are deeper."""
URDF_MAX_BYTES: Final = 4_000_000
"""Chosen: ten times the largest humanoid of the ROS packages."""
TURNING: Final = frozenset({"revolute", "continuous"})
STILL: Final = frozenset({"fixed", "prismatic"})
"""What stands at its origin: a servo turns, so none of its joints can slide."""
MESH_SUFFIX: Final = ".stl"
SHAPES: Final[Mapping[Literal["box", "cylinder", "sphere"], tuple[str, int]]] = {
    "box": ("size", 3),
    "cylinder": ("radius length", 1),
    "sphere": ("radius", 1),
}


@dataclass(slots=True)
class UrdfElement:
    """An element with its line."""

    tag: str
    line: int
    attributes: dict[str, str]
    children: list[UrdfElement] = field(default_factory=list)
    text: str = ""

    def of(self, tag: str) -> Iterator[UrdfElement]:
        return (child for child in self.children if child.tag == tag)

    def one(self, tag: str) -> UrdfElement | None:
        return next(self.of(tag), None)


@dataclass(slots=True)
class UrdfJoint:
    name: str
    element: UrdfElement
    parent: str
    child: str
    kind: str
    axis: Vector
    driver: str | None = None
    """The joint of the robot that turns it: by `ratio` times its angle, plus `offset_deg`."""
    ratio: float = 1.0
    offset_deg: float = 0.0


def urdf_figure(source: UrdfSource, joints: Collection[str]) -> Figure:
    """Return the figure of a URDF file for a robot with these joints.

    Raises `InputError` with the line, of the URDF file or of the robot file.
    """
    folder = source.robot_path.parent.resolve()
    path = source.path
    if not path.resolve().is_relative_to(folder):
        raise InputError("lies outside of the folder of the robot file", path=path)
    return _UrdfPicture(UrdfFile(path), folder, source).figure(joints)


class UrdfFile:
    """A URDF file: the elements of its links and joints by name, and how they hang together.

    Raises `InputError` with the line for what is no tree of links and joints.
    """

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        """Read the file, or `data` in its place."""
        self.path = path
        self.root = root = parsed(path, read_data(path, URDF_MAX_BYTES) if data is None else data)
        self._refuse_xacro(root)
        if root.tag != "robot":
            self.refuse(root, f"the outermost element is <{root.tag}>; a URDF file has <robot>")
        self.links = self._named(root, "link")
        if not self.links:
            self.refuse(root, "has no <link>")
        if len(self.links) > LINKS_MAX:
            self.refuse(root, f"has {len(self.links)} links; at most {LINKS_MAX} are drawn")
        self.joints = {
            name: self._joint(name, element, self.links)
            for name, element in self._named(root, "joint").items()
        }
        self.above = self._parents(self.joints)
        """The joint above each link but the first."""
        self.order = self._order(self.links, self.above, root)
        """The links, parents first."""

    def _refuse_xacro(self, element: UrdfElement) -> None:
        values = [element.tag, *element.attributes.values()]
        if element.tag.startswith("xacro:") or any("${" in v or "$(" in v for v in values):
            reason = "is a xacro file, from which a URDF file is made"
            remedy = f"`lss-motion import-urdf {self.path.name} -o NAME.yaml --allow-run`"
            self.refuse(element, f"{reason}; write one with {remedy}")
        for child in element.children:
            self._refuse_xacro(child)

    def _named(self, root: UrdfElement, tag: str) -> dict[str, UrdfElement]:
        found: dict[str, UrdfElement] = {}
        for element in root.of(tag):
            name = self.text(element, "name")
            if name in found:
                first = found[name].line
                self.refuse(element, f"{tag} {name!r} is given twice, first in line {first}")
            found[name] = element
        return found

    def _joint(self, name: str, element: UrdfElement, links: Collection[str]) -> UrdfJoint:
        kind = self.text(element, "type")
        if kind not in TURNING | STILL:
            known = known_names(kind, sorted(TURNING | STILL))
            self.refuse(element, f"joint {name!r}: type {kind!r} is not supported; {known}")
        ends = []
        for tag in ("parent", "child"):
            end = element.one(tag)
            if end is None:
                self.refuse(element, f"joint {name!r} has no <{tag}>")
            link = self.text(end, "link")
            if link not in links:
                self.refuse(
                    end, f"joint {name!r}: unknown link {link!r}; {known_names(link, links)}"
                )
            ends.append(link)
        axis = (1.0, 0.0, 0.0)  # What the format defines where it is left out.
        if (given := element.one("axis")) is not None:
            vector = self.vector(given, "xyz", axis)
            if kind in TURNING and math.hypot(*vector) == 0.0:
                self.refuse(given, f"joint {name!r}: the axis is 0 0 0; give a direction")
            axis = unit_vector(vector) if any(vector) else axis
        return UrdfJoint(name, element, ends[0], ends[1], kind, axis)

    def _parents(self, made: Mapping[str, UrdfJoint]) -> dict[str, UrdfJoint]:
        above: dict[str, UrdfJoint] = {}
        for joint in made.values():
            if joint.child in above:
                other = above[joint.child].name
                reason = f"link {joint.child!r} is the child of {other!r} already"
                self.refuse(joint.element, f"joint {joint.name!r}: {reason}")
            above[joint.child] = joint
        return above

    def _order(
        self, links: Collection[str], above: Mapping[str, UrdfJoint], root: UrdfElement
    ) -> list[str]:
        """Return the links, parents first; refuse what does not hang on one first link."""
        starts = [name for name in links if name not in above]
        if not starts:
            self.refuse(root, "its links are parents of each other; one must have none")
        if len(starts) > 1:
            names = ", ".join(starts)
            self.refuse(root, f"{len(starts)} links have no parent: {names}; one is allowed")
        below: dict[str, list[str]] = {name: [] for name in links}
        for child, joint in above.items():
            below[joint.parent].append(child)
        order, waiting = [], starts
        while waiting:
            order.append(waiting.pop())
            waiting += reversed(below[order[-1]])
        if len(order) < len(links):
            lost = next(name for name in links if name not in order)
            self.refuse(above[lost].element, f"link {lost!r} hangs in a circle of joints")
        return order

    def frame(self, element: UrdfElement) -> tuple[Vector, Rotation]:
        """Return the `<origin>` of an element: x, y, z in mm, and roll, pitch, yaw as a matrix."""
        origin = element.one("origin")
        if origin is None:
            return ORIGIN, UPRIGHT
        x, y, z = self.vector(origin, "xyz", ORIGIN)
        roll, pitch, yaw = self.vector(origin, "rpy", ORIGIN)
        about_x = turned((1.0, 0.0, 0.0), roll)
        about_y = turned((0.0, 1.0, 0.0), pitch)
        about_z = turned((0.0, 0.0, 1.0), yaw)
        return (
            (MM_PER_M * x, MM_PER_M * y, MM_PER_M * z),
            _times(about_z, _times(about_y, about_x)),
        )

    def text(self, element: UrdfElement, key: str) -> str:
        text = element.attributes.get(key, "").strip()
        if not text:
            self.refuse(element, f"<{element.tag}> has no {key!r}")
        return text

    def number(self, element: UrdfElement, key: str, default: float) -> float:
        return self.numbers(element, key, 1)[0] if key in element.attributes else default

    def vector(self, element: UrdfElement, key: str, default: Vector) -> Vector:
        if key not in element.attributes:
            return default
        x, y, z = self.numbers(element, key, 3)
        return (x, y, z)

    def numbers(self, element: UrdfElement, key: str, count: int) -> list[float]:
        text = self.text(element, key)
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            allowed = "a number" if count == 1 else f"{count} numbers"
            self.refuse(element, f"<{element.tag}>: {key} {text[:60]!r} must be {allowed}")
        return numbers

    def refuse(self, element: UrdfElement, reason: str) -> NoReturn:
        raise InputError(reason, path=self.path, line=element.line)


class _UrdfPicture:
    """Makes the figure of one file for a robot with some joints."""

    def __init__(self, file: UrdfFile, folder: Path, source: UrdfSource) -> None:
        self._file = file
        self._folder = folder
        self._source = source
        self._notes: list[str] = []

    def figure(self, joints: Collection[str]) -> Figure:
        file = self._file
        self._drive(file.joints, joints)
        links = [
            self._link(name, file.links[name], file.order, file.above, file.joints)
            for name in file.order
        ]
        return Figure(source="urdf", links=tuple(links), notes=tuple(self._notes))

    def _drive(self, made: Mapping[str, UrdfJoint], joints: Collection[str]) -> None:
        """Note which joint of the robot turns which joint of the file."""
        for joint in joints:
            name = self._source.joints.get(joint, joint)
            if name in made:
                driven = made[name]
                if driven.kind not in TURNING:
                    reason = f"joint {name!r} is {driven.kind}, and a servo turns it"
                    self._file.refuse(
                        driven.element, f"{reason}; change its type, or its name in 'urdf'"
                    )
                driven.driver = joint
            elif joint in self._source.joints:
                self._refuse_name(joint, f"unknown joint {name!r}; {known_names(name, made)}")
            else:
                self._notes.append(
                    f"{joint} is no joint of {self._file.path.name}; it is not shown"
                )
        if not any(joint.driver for joint in made.values()):
            known = known_names("", made)
            self._refuse_name("", f"no joint of the robot has the name of one in it; {known}")
        for one in made.values():
            if one.driver is None and one.kind in TURNING:
                self._mimic(one, made)

    def _mimic(self, joint: UrdfJoint, made: Mapping[str, UrdfJoint]) -> None:
        """Follow `<mimic>` to a joint that a servo turns; a joint that none turns stands at 0."""
        ratio, offset_deg = 1.0, 0.0
        seen = [joint.name]
        here = joint
        while here.driver is None and (mimic := here.element.one("mimic")) is not None:
            name = self._file.text(mimic, "joint")
            if name not in made:
                self._file.refuse(
                    mimic, f"mimic: unknown joint {name!r}; {known_names(name, made)}"
                )
            if name in seen:
                self._file.refuse(mimic, f"joints mimic each other: {', '.join(seen)}")
            seen.append(name)
            offset_deg += ratio * math.degrees(self._file.number(mimic, "offset", 0.0))
            ratio *= self._file.number(mimic, "multiplier", 1.0)
            here = made[name]
        joint.driver, joint.ratio, joint.offset_deg = here.driver, ratio, offset_deg
        if here.driver is not None:
            offset_deg += ratio * here.offset_deg
            joint.ratio, joint.offset_deg = ratio * here.ratio, offset_deg

    def _link(
        self,
        name: str,
        element: UrdfElement,
        order: list[str],
        above: Mapping[str, UrdfJoint],
        made: Mapping[str, UrdfJoint],
    ) -> FigureLink:
        ends = [self._file.frame(one.element)[0] for one in made.values() if one.parent == name]
        lines = tuple((ORIGIN, end) for end in ends if math.hypot(*end) > 0.0)
        shapes = tuple(shape for visual in element.of("visual") if (shape := self._drawn(visual)))
        joint = above.get(name)
        mass_kg, com_mm, inertia = self._mass(element)
        if joint is None:
            return FigureLink(
                name=name,
                lines_mm=lines,
                shapes=shapes,
                mass_kg=mass_kg,
                com_mm=com_mm,
                inertia_kg_m2=inertia,
            )
        origin_mm, rotation = self._file.frame(joint.element)
        is_still = joint.driver is None or joint.ratio == 0.0
        if is_still and joint.offset_deg:
            rotation = _times(rotation, turned(joint.axis, math.radians(joint.offset_deg)))
        return FigureLink(
            name=name,
            parent=order.index(joint.parent),
            joint=None if is_still else joint.driver,
            ratio=1.0 if is_still else joint.ratio,
            rest_deg=0.0 if is_still else -joint.offset_deg / joint.ratio,
            axis=joint.axis,
            origin_mm=origin_mm,
            rotation=rotation,
            lines_mm=lines,
            shapes=shapes,
            mass_kg=mass_kg,
            com_mm=com_mm,
            inertia_kg_m2=inertia,
        )

    def _mass(self, element: UrdfElement) -> tuple[float | None, Vector, Rotation | None]:
        """Return the mass of a link in kg (None: unknown), its centre in mm, and its inertia."""
        inertial = element.one("inertial")
        mass = None if inertial is None else inertial.one("mass")
        if inertial is None or mass is None:
            return None, ORIGIN, None
        try:
            (mass_kg,) = self._file.numbers(mass, "value", 1)
            if mass_kg < 0.0:
                self._file.refuse(mass, f"<mass>: value {mass_kg:g} must not be below 0")
            com_mm, rotation = self._file.frame(inertial)
            return mass_kg, com_mm, self._inertia(inertial.one("inertia"), rotation)
        except InputError as error:
            self._notes.append(f"line {error.line}: {error.reason}; the mass counts as unknown")
            return None, ORIGIN, None

    def _inertia(self, inertia: UrdfElement | None, rotation: Rotation) -> Rotation | None:
        """Return an inertia in the frame of the link; None: the file has none."""
        if inertia is None:
            return None
        xx, yy, zz, xy, xz, yz = (
            self._file.number(inertia, key, 0.0)
            for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        if not any((xx, yy, zz)):
            return None  # No body has that.
        about = _times(rotation, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        one, two, three = zip(*rotation, strict=True)
        return _times(about, (one, two, three))

    def _drawn(self, visual: UrdfElement) -> Shape | None:
        """Return the shape of a `<visual>`, or note why it cannot be drawn."""
        try:
            return self._shape(visual)
        except InputError as error:
            self._notes.append(f"line {error.line}: {error.reason}; it is not drawn")
            return None

    def _shape(self, visual: UrdfElement) -> Shape | None:
        geometry = visual.one("geometry")
        if geometry is None or not geometry.children:
            self._file.refuse(
                visual, "<visual> has no <geometry> with a box, cylinder, sphere or mesh"
            )
        solid = geometry.children[0]
        origin_mm, rotation = self._file.frame(visual)
        if solid.tag == "mesh":
            return self._mesh(solid, origin_mm, rotation)
        kind = next((kind for kind in SHAPES if kind == solid.tag), None)
        if kind is None:
            known = known_names(solid.tag, [*SHAPES, "mesh"])
            self._file.refuse(solid, f"<{solid.tag}> is no shape; {known}")
        keys, count = SHAPES[kind]
        size_mm = [
            MM_PER_M * value
            for key in keys.split()
            for value in self._file.numbers(solid, key, count)
        ]
        if min(size_mm) <= 0.0:
            self._file.refuse(solid, f"<{solid.tag}>: a size must be above 0")
        return Shape(kind=kind, size_mm=tuple(size_mm), origin_mm=origin_mm, rotation=rotation)

    def _mesh(self, solid: UrdfElement, origin_mm: Vector, rotation: Rotation) -> Shape | None:
        named = self._file.text(solid, "filename")
        scheme, _, rest = named.rpartition("://")
        file = PurePosixPath(rest.replace("\\", "/"))
        choices = [file]
        if scheme == "package":
            choices.append(PurePosixPath(*file.parts[1:]))
        if file.is_absolute() or ".." in file.parts or scheme not in ("", "package"):
            reason = f"mesh {named!r}: only files below the folder of the robot file are read"
            self._file.refuse(solid, f"{reason}; write its path from there")
        found = next((one for one in choices if self._is_below(self._folder / one)), None)
        if found is None:
            self._notes.append(f"line {solid.line}: mesh {named!r} is not below {self._folder}")
            return None
        if found.suffix.lower() != MESH_SUFFIX:
            self._notes.append(
                f"line {solid.line}: mesh {named!r} is not drawn, only STL files are"
            )
            return None
        scale = self._file.vector(solid, "scale", (1.0, 1.0, 1.0))
        size_mm = (MM_PER_M * scale[0], MM_PER_M * scale[1], MM_PER_M * scale[2])
        return Shape(
            kind="mesh", size_mm=size_mm, origin_mm=origin_mm, rotation=rotation, path=str(found)
        )

    def _is_below(self, path: Path) -> bool:
        return path.is_file() and path.resolve().is_relative_to(self._folder)

    def _refuse_name(self, joint: str, reason: str) -> NoReturn:
        """Refuse what the robot file says."""
        line = self._source.lines.get(joint)
        robot_path = None if line is None else self._source.robot_path
        raise InputError(f"urdf {self._file.path.name}: {reason}", path=robot_path, line=line)


def parsed(path: Path, data: bytes) -> UrdfElement:
    """Return the outermost element of an XML text, or raise `InputError` with the line."""
    parser = expat.ParserCreate()
    stack = [UrdfElement("", 1, {})]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > DEPTH_MAX:
            line = parser.CurrentLineNumber
            raise InputError(f"nested more than {DEPTH_MAX} deep", path=path, line=line)
        element = UrdfElement(tag, parser.CurrentLineNumber, attributes)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def add_text(text: str) -> None:
        stack[-1].text += text

    def refuse_type(*_: object) -> None:
        reason = "a document type is not accepted; remove <!DOCTYPE …>"
        raise InputError(reason, path=path, line=parser.CurrentLineNumber)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = add_text
    parser.StartDoctypeDeclHandler = refuse_type
    try:
        parser.Parse(data, True)  # noqa: FBT003  (expat takes no keyword)
    except expat.ExpatError as error:
        raise InputError(
            f"not XML: {expat.ErrorString(error.code)}", path=path, line=error.lineno
        ) from error
    return stack[0].children[0]


def _times(one: Rotation, two: Rotation) -> Rotation:
    """Return the product of two matrices."""
    rows = [
        tuple(sum(one[row][k] * two[k][column] for k in range(3)) for column in range(3))
        for row in range(3)
    ]
    return (
        (rows[0][0], rows[0][1], rows[0][2]),
        (rows[1][0], rows[1][1], rows[1][2]),
        (rows[2][0], rows[2][1], rows[2][2]),
    )
