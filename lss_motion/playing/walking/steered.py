"""A walk that is steered by velocities: its largest ones, its planner and its pilot in one.

The command `walk` has keys and a gamepad besides; `SteeredWalk` is for what has velocities, as a
program in Python (`lss.walk`).
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final, Self

from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.playing.walking.pilot import Pilot
from lss_motion.playing.walking.planner import PlannerProcess, WalkPlanner
from lss_motion.show.gait.model import Walk
from lss_motion.show.gait.steering import slowed_to_limits
from lss_motion.show.gait.stepping import STILL, Twist

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait

TOP_STRIDE_MM: Final = 40.0

TOP_TURN_DEG: Final = 12.0
"""The largest motion in one cycle, if neither the file nor an option sets it. It is halved while it
is out of reach, at most `HALVINGS_MAX` times. Chosen: half of the reach of the example robots."""

HALVINGS_MAX: Final = 4


def fastest(gait: Gait, robot: Robot, wanted: Mapping[str, float | None]) -> tuple[Gait, Twist]:
    """Return the gait with a cycle that the servos can follow, and its largest velocity.

    `wanted` are largest velocities by the names of `Twist`; what is not given is the largest of the
    file. Raises `InputError` or `PlanningError` if one of these is out of reach.
    """
    top, assumed = STILL, {}
    for name, value in (
        ("forward_mm_s", TOP_STRIDE_MM / gait.cycle_s),
        ("left_mm_s", TOP_STRIDE_MM / gait.cycle_s),
        ("turn_deg_s", TOP_TURN_DEG / gait.cycle_s),
    ):
        option = wanted.get(name)
        walks = [abs(getattr(action, name)) for action in gait.actions if isinstance(action, Walk)]
        if option is None and max(walks, default=0.0) == 0.0:
            assumed[name] = value
        else:
            top = replace(top, **{name: option or max(walks)})
    for name, value in assumed.items():
        for halvings in range(HALVINGS_MAX):
            with contextlib.suppress(InputError, PlanningError):
                slowed_to_limits(gait, robot, replace(STILL, **{name: value / 2**halvings}))
                top = replace(top, **{name: value / 2**halvings})
                break
    return slowed_to_limits(gait, robot, top)


class SteeredWalk:
    """Keeps one player walking at the velocity that was set last; a context manager."""

    def __init__(self, gait: Gait, robot: Robot, top: Twist, tolerance_deg: float) -> None:
        """Walk `gait`, which `fastest` has made for `top`."""
        self._top = top
        self._planner = WalkPlanner(gait, robot, tolerance_deg)
        self._link = PlannerProcess(gait, robot, tolerance_deg)
        self._pilot: Pilot | None = None
        self._told = ""

    def __enter__(self) -> Self:
        """Wait until the planner is ready; raises `PlanningError` if it does not start."""
        link = self._link.__enter__()
        self._pilot = Pilot(
            link,
            phase_s=self._planner.phase_s,
            splice_s=self._planner.splice_s,
            planning_s=link.planning_s,
        )
        return self

    def __exit__(self, *error: object) -> None:
        self._link.close()

    @property
    def pilot(self) -> Pilot:
        """What requests plans; there is one within the context."""
        assert self._pilot is not None, "it is entered before it is used"
        return self._pilot

    def steer(self, forward_mm_s: float, left_mm_s: float, turn_deg_s: float) -> None:
        """Walk at this velocity from the next steps on, each part within the largest one."""
        top = self._top
        self.pilot.commanded = Twist(
            forward_mm_s=_within(forward_mm_s, top.forward_mm_s),
            left_mm_s=_within(left_mm_s, top.left_mm_s),
            turn_deg_s=_within(turn_deg_s, top.turn_deg_s),
        )

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait: a plan that has come."""
        return [self._link.fileno()]

    def act(self, player: Player, now_ns: int) -> None:
        """Give the player the plan that has come, and request the next one when it is due."""
        self.pilot.act(player, now_ns)

    def brake(self, player: Player, now_ns: int) -> None:
        """Go to a stand; the plan that is played ends in one."""
        del player, now_ns
        self.pilot.commanded = STILL

    def take_texts(self) -> list[str]:
        """Return why the velocity that was set is not walked, once."""
        told, self._told = self._told, self.pilot.reason
        return [self._told] if self._told and self._told != told else []


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)
