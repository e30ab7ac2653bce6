"""A URDF file → `Figure`: its joints, frames and visual shapes; everything else in it is ignored.

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
class _Element:
    """An element with its line."""

    tag: str
    line: int
    attributes: dict[str, str]
    children: list[_Element] = field(default_factory=list)

    def of(self, tag: str) -> Iterator[_Element]:
        return (child for child in self.children if child.tag == tag)

    def one(self, tag: str) -> _Element | None:
        return next(self.of(tag), None)


@dataclass(slots=True)
class _UrdfJoint:
    name: str
    element: _Element
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
    return _UrdfReader(path, folder, source).figure(joints)


class _UrdfReader:
    """Reads one file."""

    def __init__(self, path: Path, folder: Path, source: UrdfSource) -> None:
        self._path = path
        self._folder = folder
        self._source = source
        self._notes: list[str] = []

    def figure(self, joints: Collection[str]) -> Figure:
        root = _parsed(self._path)
        self._refuse_xacro(root)
        if root.tag != "robot":
            self._refuse(root, f"the outermost element is <{root.tag}>; a URDF file has <robot>")
        elements = self._named(root, "link")
        if not elements:
            self._refuse(root, "has no <link>")
        if len(elements) > LINKS_MAX:
            self._refuse(root, f"has {len(elements)} links; at most {LINKS_MAX} are drawn")
        made = {
            name: self._joint(name, element, elements)
            for name, element in self._named(root, "joint").items()
        }
        self._drive(made, joints)
        above = self._parents(made)
        order = self._order(elements, above, root)
        links = [self._link(name, elements[name], order, above, made) for name in order]
        return Figure(source="urdf", links=tuple(links), notes=tuple(self._notes))

    def _refuse_xacro(self, element: _Element) -> None:
        values = [element.tag, *element.attributes.values()]
        if element.tag.startswith("xacro:") or any("${" in v or "$(" in v for v in values):
            out = self._path.with_suffix("").stem + ".urdf"
            reason = "is a xacro file, from which a URDF file is made"
            self._refuse(element, f"{reason}; write one with `xacro {self._path.name} > {out}`")
        for child in element.children:
            self._refuse_xacro(child)

    def _named(self, root: _Element, tag: str) -> dict[str, _Element]:
        found: dict[str, _Element] = {}
        for element in root.of(tag):
            name = self._text(element, "name")
            if name in found:
                first = found[name].line
                self._refuse(element, f"{tag} {name!r} is given twice, first in line {first}")
            found[name] = element
        return found

    def _joint(self, name: str, element: _Element, links: Collection[str]) -> _UrdfJoint:
        kind = self._text(element, "type")
        if kind not in TURNING | STILL:
            known = known_names(kind, sorted(TURNING | STILL))
            self._refuse(element, f"joint {name!r}: type {kind!r} is not supported; {known}")
        ends = []
        for tag in ("parent", "child"):
            end = element.one(tag)
            if end is None:
                self._refuse(element, f"joint {name!r} has no <{tag}>")
            link = self._text(end, "link")
            if link not in links:
                self._refuse(
                    end, f"joint {name!r}: unknown link {link!r}; {known_names(link, links)}"
                )
            ends.append(link)
        axis = (1.0, 0.0, 0.0)  # What the format defines where it is left out.
        if (given := element.one("axis")) is not None:
            vector = self._vector(given, "xyz", axis)
            if kind in TURNING and math.hypot(*vector) == 0.0:
                self._refuse(given, f"joint {name!r}: the axis is 0 0 0; give a direction")
            axis = unit_vector(vector) if any(vector) else axis
        return _UrdfJoint(name, element, ends[0], ends[1], kind, axis)

    def _drive(self, made: Mapping[str, _UrdfJoint], joints: Collection[str]) -> None:
        """Note which joint of the robot turns which joint of the file."""
        for joint in joints:
            name = self._source.joints.get(joint, joint)
            if name in made:
                driven = made[name]
                if driven.kind not in TURNING:
                    reason = f"joint {name!r} is {driven.kind}, and a servo turns it"
                    self._refuse(
                        driven.element, f"{reason}; change its type, or its name in 'urdf'"
                    )
                driven.driver = joint
            elif joint in self._source.joints:
                self._refuse_name(joint, f"unknown joint {name!r}; {known_names(name, made)}")
            else:
                self._notes.append(f"{joint} is no joint of {self._path.name}; it is not shown")
        if not any(joint.driver for joint in made.values()):
            known = known_names("", made)
            self._refuse_name("", f"no joint of the robot has the name of one in it; {known}")
        for one in made.values():
            if one.driver is None and one.kind in TURNING:
                self._mimic(one, made)

    def _mimic(self, joint: _UrdfJoint, made: Mapping[str, _UrdfJoint]) -> None:
        """Follow `<mimic>` to a joint that a servo turns; a joint that none turns stands at 0."""
        ratio, offset_deg = 1.0, 0.0
        seen = [joint.name]
        here = joint
        while here.driver is None and (mimic := here.element.one("mimic")) is not None:
            name = self._text(mimic, "joint")
            if name not in made:
                self._refuse(mimic, f"mimic: unknown joint {name!r}; {known_names(name, made)}")
            if name in seen:
                self._refuse(mimic, f"joints mimic each other: {', '.join(seen)}")
            seen.append(name)
            offset_deg += ratio * math.degrees(self._number(mimic, "offset", 0.0))
            ratio *= self._number(mimic, "multiplier", 1.0)
            here = made[name]
        joint.driver, joint.ratio, joint.offset_deg = here.driver, ratio, offset_deg
        if here.driver is not None:
            offset_deg += ratio * here.offset_deg
            joint.ratio, joint.offset_deg = ratio * here.ratio, offset_deg

    def _parents(self, made: Mapping[str, _UrdfJoint]) -> dict[str, _UrdfJoint]:
        above: dict[str, _UrdfJoint] = {}
        for joint in made.values():
            if joint.child in above:
                other = above[joint.child].name
                reason = f"link {joint.child!r} is the child of {other!r} already"
                self._refuse(joint.element, f"joint {joint.name!r}: {reason}")
            above[joint.child] = joint
        return above

    def _order(
        self, links: Collection[str], above: Mapping[str, _UrdfJoint], root: _Element
    ) -> list[str]:
        """Return the links, parents first; refuse what does not hang on one first link."""
        starts = [name for name in links if name not in above]
        if not starts:
            self._refuse(root, "its links are parents of each other; one must have none")
        if len(starts) > 1:
            names = ", ".join(starts)
            self._refuse(root, f"{len(starts)} links have no parent: {names}; one is allowed")
        below: dict[str, list[str]] = {name: [] for name in links}
        for child, joint in above.items():
            below[joint.parent].append(child)
        order, waiting = [], starts
        while waiting:
            order.append(waiting.pop())
            waiting += reversed(below[order[-1]])
        if len(order) < len(links):
            lost = next(name for name in links if name not in order)
            self._refuse(above[lost].element, f"link {lost!r} hangs in a circle of joints")
        return order

    def _link(
        self,
        name: str,
        element: _Element,
        order: list[str],
        above: Mapping[str, _UrdfJoint],
        made: Mapping[str, _UrdfJoint],
    ) -> FigureLink:
        ends = [self._frame(one.element)[0] for one in made.values() if one.parent == name]
        lines = tuple((ORIGIN, end) for end in ends if math.hypot(*end) > 0.0)
        shapes = tuple(shape for visual in element.of("visual") if (shape := self._drawn(visual)))
        joint = above.get(name)
        if joint is None:
            return FigureLink(name=name, lines_mm=lines, shapes=shapes)
        origin_mm, rotation = self._frame(joint.element)
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
        )

    def _drawn(self, visual: _Element) -> Shape | None:
        """Return the shape of a `<visual>`, or note why it cannot be drawn."""
        try:
            return self._shape(visual)
        except InputError as error:
            self._notes.append(f"line {error.line}: {error.reason}; it is not drawn")
            return None

    def _shape(self, visual: _Element) -> Shape | None:
        geometry = visual.one("geometry")
        if geometry is None or not geometry.children:
            self._refuse(visual, "<visual> has no <geometry> with a box, cylinder, sphere or mesh")
        solid = geometry.children[0]
        origin_mm, rotation = self._frame(visual)
        if solid.tag == "mesh":
            return self._mesh(solid, origin_mm, rotation)
        kind = next((kind for kind in SHAPES if kind == solid.tag), None)
        if kind is None:
            known = known_names(solid.tag, [*SHAPES, "mesh"])
            self._refuse(solid, f"<{solid.tag}> is no shape; {known}")
        keys, count = SHAPES[kind]
        size_mm = [
            MM_PER_M * value for key in keys.split() for value in self._numbers(solid, key, count)
        ]
        if min(size_mm) <= 0.0:
            self._refuse(solid, f"<{solid.tag}>: a size must be above 0")
        return Shape(kind=kind, size_mm=tuple(size_mm), origin_mm=origin_mm, rotation=rotation)

    def _mesh(self, solid: _Element, origin_mm: Vector, rotation: Rotation) -> Shape | None:
        named = self._text(solid, "filename")
        scheme, _, rest = named.rpartition("://")
        file = PurePosixPath(rest.replace("\\", "/"))
        choices = [file]
        if scheme == "package":
            choices.append(PurePosixPath(*file.parts[1:]))
        if file.is_absolute() or ".." in file.parts or scheme not in ("", "package"):
            reason = f"mesh {named!r}: only files below the folder of the robot file are read"
            self._refuse(solid, f"{reason}; write its path from there")
        found = next((one for one in choices if self._is_below(self._folder / one)), None)
        if found is None:
            self._notes.append(f"line {solid.line}: mesh {named!r} is not below {self._folder}")
            return None
        if found.suffix.lower() != MESH_SUFFIX:
            self._notes.append(
                f"line {solid.line}: mesh {named!r} is not drawn, only STL files are"
            )
            return None
        scale = self._vector(solid, "scale", (1.0, 1.0, 1.0))
        size_mm = (MM_PER_M * scale[0], MM_PER_M * scale[1], MM_PER_M * scale[2])
        return Shape(
            kind="mesh", size_mm=size_mm, origin_mm=origin_mm, rotation=rotation, path=str(found)
        )

    def _is_below(self, path: Path) -> bool:
        return path.is_file() and path.resolve().is_relative_to(self._folder)

    def _frame(self, element: _Element) -> tuple[Vector, Rotation]:
        """Return the `<origin>` of an element: x, y, z in mm, and roll, pitch, yaw as a matrix."""
        origin = element.one("origin")
        if origin is None:
            return ORIGIN, UPRIGHT
        x, y, z = self._vector(origin, "xyz", ORIGIN)
        roll, pitch, yaw = self._vector(origin, "rpy", ORIGIN)
        about_x = turned((1.0, 0.0, 0.0), roll)
        about_y = turned((0.0, 1.0, 0.0), pitch)
        about_z = turned((0.0, 0.0, 1.0), yaw)
        return (
            (MM_PER_M * x, MM_PER_M * y, MM_PER_M * z),
            _times(about_z, _times(about_y, about_x)),
        )

    def _text(self, element: _Element, key: str) -> str:
        text = element.attributes.get(key, "").strip()
        if not text:
            self._refuse(element, f"<{element.tag}> has no {key!r}")
        return text

    def _number(self, element: _Element, key: str, default: float) -> float:
        return self._numbers(element, key, 1)[0] if key in element.attributes else default

    def _vector(self, element: _Element, key: str, default: Vector) -> Vector:
        if key not in element.attributes:
            return default
        x, y, z = self._numbers(element, key, 3)
        return (x, y, z)

    def _numbers(self, element: _Element, key: str, count: int) -> list[float]:
        text = self._text(element, key)
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            allowed = "a number" if count == 1 else f"{count} numbers"
            self._refuse(element, f"<{element.tag}>: {key} {text[:60]!r} must be {allowed}")
        return numbers

    def _refuse(self, element: _Element, reason: str) -> NoReturn:
        raise InputError(reason, path=self._path, line=element.line)

    def _refuse_name(self, joint: str, reason: str) -> NoReturn:
        """Refuse what the robot file says."""
        line = self._source.lines.get(joint)
        robot_path = None if line is None else self._source.robot_path
        raise InputError(f"urdf {self._path.name}: {reason}", path=robot_path, line=line)


def _parsed(path: Path) -> _Element:
    """Return the outermost element of an XML file, or raise `InputError` with the line."""
    parser = expat.ParserCreate()
    stack = [_Element("", 1, {})]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > DEPTH_MAX:
            line = parser.CurrentLineNumber
            raise InputError(f"nested more than {DEPTH_MAX} deep", path=path, line=line)
        element = _Element(tag, parser.CurrentLineNumber, attributes)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def refuse_type(*_: object) -> None:
        reason = "a document type is not accepted; remove <!DOCTYPE …>"
        raise InputError(reason, path=path, line=parser.CurrentLineNumber)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse_type
    data = read_data(path, URDF_MAX_BYTES)
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
