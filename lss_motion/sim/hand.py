"""A hand that moves limp servos: joint angles over time, from a CSV file or from a seed."""

from __future__ import annotations

import csv
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import read_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint, Robot

    FloatArray = NDArray[np.float64]

MOVE_S: Final = (0.6, 2.0)
REST_S: Final = (0.2, 1.0)
SHOWN_S: Final = 30.0
"""A hand from a seed moves for so long, each joint by moves of a person's pace. Chosen."""

TIME_COLUMN: Final = "t_s"


HAND_DEG_S: Final = 600.0
"""As fast as a hand turns a horn that was elsewhere when it was let go. Assumed."""


class HandGuide(Struct, frozen=True, eq=False):
    """Servo angles at increasing times, in seconds from power-up, where a hand leads one horn."""

    times_s: FloatArray
    servo_deg: FloatArray

    def at(self, time_s: float) -> float | None:
        """Return where the hand has the horn; None while there is no hand."""
        if not self.times_s[0] <= time_s <= self.times_s[-1]:
            return None
        return float(np.interp(time_s, self.times_s, self.servo_deg))

    def is_over(self, time_s: float) -> bool:
        return time_s > float(self.times_s[-1])


class Push(Struct, frozen=True):
    """A push that displaces a powered horn by `deg` (servo angle), in seconds from power-up."""

    from_s: float
    until_s: float
    deg: float


class HandMotion(Struct, frozen=True, eq=False):
    """Joint angles (degrees) at increasing times, in seconds from power-up; straight between.

    A limp servo stands where the hand is; a powered one yields a little, the more the softer it
    holds. After the last time, and for joints not named, there is no hand.
    """

    times_s: FloatArray
    angles_deg: Mapping[str, FloatArray]

    def led(self, joint: Joint) -> HandGuide | None:
        """Return how the hand leads one servo, if it does."""
        column = self.angles_deg.get(joint.name)
        if column is None:
            return None
        return HandGuide(self.times_s, joint.zero_deg + joint.direction * column)


def hand_of(text: str, robot: Robot) -> HandMotion:
    """Return the hand of a seed, or of the file at a path."""
    return hand_from_seed(int(text), robot) if text.isdigit() else load_hand(Path(text), robot)


def load_hand(path: Path, robot: Robot) -> HandMotion:
    """Return the hand in a CSV file `t_s,<joint>,…` (joint degrees), or raise `InputError`."""
    rows = list(csv.reader(read_text(path).splitlines()))
    if not rows or rows[0][:1] != [TIME_COLUMN] or len(rows[0]) < 2:
        raise InputError(f"must start with a header {TIME_COLUMN},<joint>,...", path=path, line=1)
    names = rows[0][1:]
    if unknown := [name for name in names if name not in robot.joints]:
        raise InputError(
            f"robot {robot.name!r} has no joint {unknown[0]!r:.60}; it has "
            f"{', '.join(robot.joints)}",
            path=path,
            line=1,
        )
    table: list[list[float]] = []
    for line, row in enumerate(rows[1:], start=2):
        try:
            values = [float(cell) for cell in row]
        except ValueError as error:
            raise InputError(f"{error}", path=path, line=line) from error
        if len(values) != len(rows[0]) or not np.isfinite(values).all():
            raise InputError(f"must have {len(rows[0])} finite numbers", path=path, line=line)
        if table and values[0] <= table[-1][0]:
            raise InputError("times must increase", path=path, line=line)
        table.append(values)
    if not table:
        raise InputError("has no row", path=path)
    columns = np.array(table).T
    return HandMotion(columns[0], dict(zip(names, columns[1:], strict=True)))


def hand_from_seed(seed: int, robot: Robot) -> HandMotion:
    """Return a hand that leads every joint through its range, rest to rest, for `SHOWN_S`."""
    times_s = np.arange(0.0, SHOWN_S, 0.01)
    angles_deg: dict[str, FloatArray] = {}
    for name, joint in robot.joints.items():
        random = Random(f"{seed}/hand/{name}")
        low, high = joint.position_min_deg, joint.position_max_deg
        here_deg = min(max(0.0, low), high)
        column = np.empty(len(times_s))
        now_s = 0.0
        column[:] = here_deg
        while now_s < SHOWN_S:
            now_s += random.uniform(*REST_S)
            there_deg, spent_s = random.uniform(low, high), random.uniform(*MOVE_S)
            least_s = 3.0 * abs(there_deg - here_deg) / joint.speed_max_deg_s
            spent_s = max(spent_s, least_s)
            share = np.clip((times_s - now_s) / spent_s, 0.0, 1.0)
            eased = share**3 * (10.0 + share * (6.0 * share - 15.0))
            column = np.where(times_s >= now_s, here_deg + (there_deg - here_deg) * eased, column)
            here_deg, now_s = there_deg, now_s + spent_s
        angles_deg[name] = column
    return HandMotion(times_s, angles_deg)
