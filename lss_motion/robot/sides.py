"""Groups of joints, and which joint is the mirror image of which."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from lss_motion.spelling import known_names
from lss_motion.yaml_source import Problem

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from lss_motion.robot.file import MirrorEntry

    Image = tuple[str, Literal[1, -1]]


def grouped(
    groups: Mapping[str, Sequence[str]], joints: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """Return the joints of every group, in the order of `joints`."""
    return {
        group: tuple(name for name in joints if name in members)
        for group, members in groups.items()
    }


def group_problems(
    groups: Mapping[str, Sequence[str]], joints: Collection[str]
) -> Iterator[Problem]:
    """Yield every member that is no joint, and every group that is called like one."""
    for group, members in groups.items():
        if group in joints:
            yield Problem(("groups", group), f"group {group!r} has the name of a joint")
        for index, name in enumerate(members):
            if name not in joints:
                reason = f"group {group!r}: unknown joint {name!r}; {known_names(name, joints)}"
                yield Problem(("groups", group, index), reason)


def mirrored(entry: MirrorEntry) -> dict[str, Image]:
    """Return the image of every joint that has one, and the sign of its angle there."""
    images: dict[str, Image] = {}
    for left, right in entry.same.items():
        images |= {left: (right, 1), right: (left, 1)}
    for left, right in entry.opposite.items():
        images |= {left: (right, -1), right: (left, -1)}
    return images


def mirror_problems(entry: MirrorEntry, joints: Collection[str]) -> Iterator[Problem]:
    """Yield every pair with a joint that is unknown, or has an image already."""
    seen: set[str] = set()
    for key, pairs in (("same", entry.same), ("opposite", entry.opposite)):
        for left, right in pairs.items():
            place = ("mirror", key, left)
            for name in sorted({left, right}):
                if name not in joints:
                    yield Problem(place, f"unknown joint {name!r}; {known_names(name, joints)}")
                elif name in seen:
                    yield Problem(place, f"joint {name!r} has a mirror image already; keep one")
            seen |= {left, right}
