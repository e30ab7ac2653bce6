"""The figure of a robot file: links of its entries, and what is wrong with them."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

from lss_motion.files.texts import known_names
from lss_motion.files.yaml_source import Mistake
from lss_motion.robot.figure import ORIGIN, Figure, FigureLink, Shape, unit_vector

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from lss_motion.robot.figure import Shade, Vector
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
                lines_mm=((ORIGIN, end),) if entry.length_mm and not entry.ball_mm else (),
                width_mm=entry.width_mm,
                shade=entry.shade,
                shapes=() if entry.ball_mm is None else (_ball(entry.ball_mm, end, entry.shade),),
            )
        )
    return Figure(source="figure", links=tuple(links), feet=tuple(feet)), []


def _ball(ball_mm: Sequence[float], end: Vector, shade: Shade | None) -> Shape:
    """Return a ball in the middle of a link that ends there."""
    x, y, z = ball_mm
    middle = (end[0] / 2.0, end[1] / 2.0, end[2] / 2.0)
    half_axes = (x / 2.0, y / 2.0, z / 2.0)
    return Shape(kind="ball", size_mm=half_axes, origin_mm=middle, shade=shade)


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
    parents = {name: {entry.parent} for name, entry in entries.items() if entry.parent}
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        reason = f"links are parents of each other: {' → '.join(cycle)}; one must stand alone"
        yield Mistake(("figure", cycle[0], "parent"), reason)
