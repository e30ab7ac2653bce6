"""The figure of a robot file: links of its entries, and what is wrong with them."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake
from lss_motion.robot.figure import (
    ORIGIN,
    Figure,
    FigureLink,
    Shape,
    capsule,
    middle_of,
    unit_vector,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from lss_motion.robot.figure import Vector
    from lss_motion.robot.figure_file import FigureLinkEntry


def figure_from(
    entries: Mapping[str, FigureLinkEntry], joints: Collection[str]
) -> tuple[Figure | None, list[Mistake]]:
    """Return the figure of the links of a robot file, or their problems."""
    problems = list(figure_problems(entries, joints))
    if problems or not entries:
        return None, problems
    parents = {name: {entry.parent} - {None} for name, entry in entries.items()}
    order = [name for name in TopologicalSorter(parents).static_order() if name is not None]
    links: list[FigureLink] = []
    ends: list[Vector] = []
    feet = []
    for name in order:
        entry = entries[name]
        parent = -1 if entry.parent is None else order.index(entry.parent)
        start = ends[parent] if parent >= 0 else ORIGIN
        x, y, z = unit_vector(entry.along or "x")
        end = (entry.length_mm * x, entry.length_mm * y, entry.length_mm * z)
        ends.append(end)
        if entry.foot:
            feet.append((len(links), end))
        links.append(
            FigureLink(
                name=name,
                parent=parent,
                joint=entry.joint,
                rest_deg=entry.rest_deg,
                axis=unit_vector(entry.axis or "z"),
                origin_mm=(
                    start[0] + entry.offset_mm[0],
                    start[1] + entry.offset_mm[1],
                    start[2] + entry.offset_mm[2],
                ),
                lines_mm=((ORIGIN, end),) if entry.length_mm and entry.shape == "bar" else (),
                width_mm=entry.width_mm,
                shade=entry.shade,
                shapes=_shapes(entry, end),
                mass_kg=entry.mass_kg,
                com_mm=_centre(entry, end),
            )
        )
    return Figure(source="figure", links=tuple(links), feet=tuple(feet)), []


def _shapes(entry: FigureLinkEntry, end: Vector) -> tuple[Shape, ...]:
    """Return the shape of a link that ends there; a bar is its line."""
    if entry.shape == "bar":
        return ()
    if entry.shape == "capsule":
        return (capsule(ORIGIN, end, entry.width_mm or 0.0, entry.shade),)
    x, y, z = entry.size_mm or ORIGIN
    size_mm = (x, y, z) if entry.shape == "box" else (x / 2.0, y / 2.0, z / 2.0)
    middle = middle_of(ORIGIN, end)
    return (Shape(kind=entry.shape, size_mm=size_mm, origin_mm=middle, shade=entry.shade),)


def _centre(entry: FigureLinkEntry, end: Vector) -> Vector:
    """Return the centre of mass of a link that ends there; no place where it weighs nothing."""
    if entry.com_mm is not None:
        x, y, z = entry.com_mm
        return (x, y, z)
    return ORIGIN if entry.mass_kg is None else middle_of(ORIGIN, end)


_SOLID = frozenset({"box", "ellipsoid"})


def _shape_problems(name: str, entry: FigureLinkEntry) -> Iterator[Mistake]:
    place, shape = ("figure", name), entry.shape
    if shape in _SOLID and entry.size_mm is None:
        reason = f"link {name!r} is of shape {shape} and has no 'size_mm': [x, y, z]"
        yield Mistake((*place, "shape"), reason)
    if shape not in _SOLID and entry.size_mm is not None:
        remedy = "give 'shape: ellipsoid' or 'shape: box', or length_mm and width_mm"
        reason = f"link {name!r}: 'size_mm' has no meaning for shape {shape}; {remedy}"
        yield Mistake((*place, "size_mm"), reason)
    if shape in _SOLID and entry.width_mm is not None:
        reason = f"link {name!r}: 'width_mm' has no meaning for shape {shape}; its size is size_mm"
        yield Mistake((*place, "width_mm"), reason)
    if shape == "capsule" and entry.width_mm is None:
        reason = f"link {name!r} is of shape capsule and has no 'width_mm', how thick it is"
        yield Mistake((*place, "shape"), reason)
    if entry.com_mm is not None and entry.mass_kg is None:
        reason = f"link {name!r} has a centre of mass and no 'mass_kg'; give what it weighs"
        yield Mistake((*place, "com_mm"), reason)


def figure_problems(
    entries: Mapping[str, FigureLinkEntry], joints: Collection[str]
) -> Iterator[Mistake]:
    for name, entry in entries.items():
        place = ("figure", name)
        if entry.parent is not None and entry.parent not in entries:
            reason = f"link {name!r}: unknown parent {entry.parent!r}"
            yield Mistake((*place, "parent"), f"{reason}; {known_names(entry.parent, entries)}")
        if entry.joint is not None and entry.joint not in joints:
            known = known_names(entry.joint, joints)
            yield Mistake(
                (*place, "joint"), f"link {name!r}: unknown joint {entry.joint!r}; {known}"
            )
        if entry.joint is not None and entry.axis is None:
            reason = f"link {name!r} has a joint and no 'axis', about which that turns it: y, …"
            yield Mistake((*place, "axis"), reason)
        if entry.joint is None and (given := {"axis", "rest_deg"} & entry.given):
            key = min(given)
            reason = f"link {name!r} has no 'joint', so {key!r} has no meaning; remove it"
            yield Mistake((*place, key), reason)
        yield from _shape_problems(name, entry)
    parents = {name: {entry.parent} for name, entry in entries.items() if entry.parent}
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        reason = f"links are parents of each other: {' → '.join(cycle)}; one must stand alone"
        yield Mistake(("figure", cycle[0], "parent"), reason)
