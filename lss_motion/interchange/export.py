"""PlanSamples of a plan → text for other tools: CSV, ROS JointTrajectory, Blender.

All formats use the joint names of the robot, and joint angles in degrees (ROS: radians).
"""

from __future__ import annotations

import csv
import io
import json
import math
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from msgspec import Struct

from lss_motion.interchange.json_motions import TENTHS
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

ANGLE_DECIMALS: Final = 6
"""Decimals of degrees. A servo does not resolve them, but rounding adds noise to the acceleration
between samples: at 100 Hz four decimals give 2 deg/s², six give 0.02 deg/s²."""

RADIAN_DECIMALS: Final = 8
"""Decimals of radians, about as fine as `ANGLE_DECIMALS`."""


class Sampled(Protocol):
    """A plan as far as it is needed here: `Trajectory` is one."""

    @property
    def name(self) -> str: ...

    @property
    def joints(self) -> tuple[str, ...]: ...

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray: ...


class PlanSamples(Struct, frozen=True, kw_only=True):
    """A plan sampled at even times: angles and speeds, (n, joints)."""

    name: str
    joints: tuple[str, ...]
    rate_hz: float
    times_s: FloatArray
    angles_deg: FloatArray
    speeds_deg_s: FloatArray

    @classmethod
    def of(cls, plan: Sampled, until_s: float, rate_hz: float) -> PlanSamples:
        """Return samples of a plan, one every `1 / rate_hz`, to `until_s` or just beyond it."""
        times_s = np.arange(int(np.ceil(until_s * rate_hz - 1e-9)) + 1) / rate_hz
        return cls(
            name=plan.name,
            joints=plan.joints,
            rate_hz=rate_hz,
            times_s=times_s,
            angles_deg=plan.sample(times_s),
            speeds_deg_s=plan.sample(times_s, 1),
        )


def exported(samples: PlanSamples, format_name: str) -> str:
    """Return the text of one of `EXPORT_NAMES`."""
    return _WRITERS[format_name](samples)


def _table(samples: PlanSamples) -> str:
    header = ["t_s", *samples.joints]
    return _csv(header, [f"{time_s:.6f}" for time_s in samples.times_s.tolist()], samples)


def _blender_table(samples: PlanSamples) -> str:
    header = ["frame", *(f"{name}_deg" for name in samples.joints)]
    frames = [str(frame) for frame in range(len(samples.times_s))]
    return f"# fps: {samples.rate_hz:g}\n{_csv(header, frames, samples)}"


def _csv(header: Sequence[str], firsts: Sequence[str], samples: PlanSamples) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    for first, angles_deg in zip(firsts, samples.angles_deg.tolist(), strict=True):
        writer.writerow([first, *(f"{angle:.{ANGLE_DECIMALS}f}" for angle in angles_deg)])
    return out.getvalue()


def _blender_json(samples: PlanSamples) -> str:
    """Return version 2 of the format of the add-on, with positions in tenths of a degree."""
    tenths = np.round(10.0 * samples.angles_deg).astype(np.int64).tolist()
    ids = [str(index) for index in range(len(samples.joints))]
    content = {
        "description": f"{samples.name}: joint angles in tenths of a degree",
        "fps": samples.rate_hz,
        "frames": len(tenths),
        "seconds": round(float(samples.times_s[-1])),
        "bones": len(ids),
        "unit": TENTHS,
        "names": dict(zip(ids, samples.joints, strict=True)),
        "positions": [dict(zip(ids, row, strict=True)) for row in tenths],
    }
    return json.dumps(content, ensure_ascii=False) + "\n"


def _ros(samples: PlanSamples) -> str:
    """Return a trajectory_msgs/JointTrajectory message."""
    names = ", ".join(json.dumps(name, ensure_ascii=False) for name in samples.joints)
    lines = [f"joint_names: [{names}]", "points:"]
    per_deg = math.radians(1.0)
    for time_s, angles, speeds in zip(
        samples.times_s.tolist(),
        (samples.angles_deg * per_deg).tolist(),
        (samples.speeds_deg_s * per_deg).tolist(),
        strict=True,
    ):
        seconds, rest_ns = divmod(ns_from_s(time_s), ns_from_s(1.0))
        lines += [
            f"- positions: [{_numbers(angles)}]",
            f"  velocities: [{_numbers(speeds)}]",
            f"  time_from_start: {{sec: {seconds}, nanosec: {rest_ns}}}",
        ]
    return "\n".join([*lines, ""])


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, RADIAN_DECIMALS) + 0.0}" for value in values)


_WRITERS: Final[Mapping[str, Callable[[PlanSamples], str]]] = {
    "csv": _table,
    "ros": _ros,
    "blender-csv": _blender_table,
    "blender-json": _blender_json,
}

EXPORT_NAMES: Final = tuple(_WRITERS)
"""Formats that `exported` can write."""
