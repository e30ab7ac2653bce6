"""URDF files as makers write them, for the tests of `import-urdf`."""

from __future__ import annotations

import math

INERTIA = '<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, shape: str = "", mass: float | None = None, inertia: float = 0.0) -> str:
    inertial = ""
    if mass is not None:
        inertial = f'<inertial><mass value="{mass}"/>{INERTIA.format(inertia)}</inertial>'
    visual = f"<visual><geometry>{shape}</geometry></visual>" if shape else ""
    return f'  <link name="{name}">{inertial}{visual}</link>\n'


def joint(
    name: str,
    parent: str,
    child: str,
    *,
    axis: str = "0 0 1",
    xyz: str = "0 0 0",
    rpy: str = "0 0 0",
    limit: str = 'lower="-1.5708" upper="1.5708" effort="1" velocity="2"',
    kind: str = "revolute",
    more: str = "",
) -> str:
    limits = f"<limit {limit}/>" if limit else ""
    return (
        f'  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>\n'
        f'    <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limits}{more}</joint>\n'
    )


def robot(name: str, *parts: str) -> str:
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n{"".join(parts)}</robot>\n'


def arm() -> str:
    """Return an arm of three joints with the faults of makers' files."""
    box = '<box size="0.04 0.03 0.1"/>'
    return robot(
        "desk arm",
        "  <!-- drawn by hand -->\n",
        link("base"),
        link("turn", box, mass=0.2, inertia=0.0),
        link("upper", box, mass=5.0, inertia=1e-4),
        link("lower", box),
        link("finger", box, mass=0.01, inertia=1e-5),
        link("twin", box, mass=0.01, inertia=1e-5),
        joint("base yaw", "base", "turn", kind="continuous", limit=""),
        joint(
            "shoulder", "turn", "upper", axis="0 1 0", xyz="0 0 0.05", rpy="0 0.2 0.1",
            limit='lower="-4" upper="2" effort="6.5" velocity="20"',
        ),
        joint("elbow", "upper", "lower", axis="0 -1 0", xyz="0.1 0 0", limit='lower="0" upper="0"'),
        joint(
            "grip", "lower", "finger", axis="1 0 0", xyz="0.1 0.02 0",
            limit='lower="0.5" upper="-0.25" effort="1" velocity="3"',
        ),
        joint(
            "grip_twin", "lower", "twin", axis="1 0 0", xyz="0.1 -0.02 0",
            more='<mimic joint="grip" multiplier="-2" offset="0.1"/>',
        ),
    )  # fmt: skip


def hexapod() -> str:
    """Return six legs of coxa, femur and tibia; on the right side the axes are the other way."""
    parts = [link("body", '<box size="0.2 0.1 0.04"/>', mass=0.5, inertia=1e-3)]
    for side, way in (("left", 1), ("right", -1)):
        for place, x, yaw in (("front", 0.08, 40.0), ("middle", 0.0, 90.0), ("rear", -0.08, 140.0)):
            leg = f"{side[0]}{place[0]}"
            turn = math.radians(way * yaw)
            rpy = f"0 0 {turn}"
            parts += [
                link(f"{leg}_coxa", mass=0.06, inertia=1e-5),
                link(f"{leg}_femur", mass=0.06, inertia=1e-5),
                link(f"{leg}_tibia", mass=0.06, inertia=1e-5),
                link(f"{leg}_foot"),
                joint(f"{leg}_c", "body", f"{leg}_coxa", xyz=f"{x} {way * 0.06} 0.01", rpy=rpy),
                joint(
                    f"{leg}_f", f"{leg}_coxa", f"{leg}_femur", axis=f"0 {-way} 0",
                    xyz="0.05 0 -0.01", rpy="0 -0.35 0",
                ),
                joint(
                    f"{leg}_t", f"{leg}_femur", f"{leg}_tibia", axis=f"0 {way} 0", xyz="0.08 0 0",
                    rpy="0 1.6 0",
                ),
                joint(
                    f"{leg}_end", f"{leg}_tibia", f"{leg}_foot", kind="fixed", xyz="0.11 0 0",
                    limit="",
                ),
            ]  # fmt: skip
    return robot("hexa", *parts)


def quadruped() -> str:
    """Return four legs of abduction, thigh and shank, whose feet are the ends of cylinders."""
    shank = '<origin xyz="0 0 -0.05"/><geometry><cylinder radius="0.008" length="0.1"/></geometry>'
    parts = [link("trunk", '<box size="0.25 0.1 0.06"/>', mass=0.8, inertia=2e-3)]
    for side, way in (("left", 1), ("right", -1)):
        for place, x in (("front", 0.1), ("hind", -0.1)):
            leg = f"{side}_{place}"
            parts += [
                link(f"{leg}_hip_link", mass=0.06, inertia=1e-5),
                link(f"{leg}_thigh_link", mass=0.06, inertia=1e-5),
                f'  <link name="{leg}_shank_link"><visual>{shank}</visual></link>\n',
                joint(
                    f"{leg}_hip", "trunk", f"{leg}_hip_link", axis="1 0 0",
                    xyz=f"{x} {way * 0.04} 0",
                    limit='lower="-0.8" upper="0.8" effort="1" velocity="4"',
                ),
                joint(
                    f"{leg}_thigh", f"{leg}_hip_link", f"{leg}_thigh_link", axis="0 1 0",
                    xyz=f"0 {way * 0.05} 0",
                ),
                joint(
                    f"{leg}_knee", f"{leg}_thigh_link", f"{leg}_shank_link", axis="0 1 0",
                    xyz="0 0 -0.09", limit='lower="-2.4" upper="-0.1" effort="1" velocity="4"',
                ),
            ]  # fmt: skip
    return robot("quad", *parts)
