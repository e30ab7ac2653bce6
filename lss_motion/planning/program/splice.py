"""Extends a program while it is played: from an instant on, its splice, the rest is replaced.

Such a program is always complete: it ends at rest. An extension replaces all moves that are due at
or after the splice by others, which end at rest as well. So a player that gets no further
extension, or gets it too late, plays to that end.

The moves of an extension start from the profiles of the servos after the moves before the splice,
in motion: no joint stops, and nothing is compiled twice.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.program.line import LineSchedule, LineUse
from lss_motion.planning.program.model import Move, Program, received_us, target_deg
from lss_motion.planning.program.move_table import lines_use, moves_of
from lss_motion.planning.program.moves import InitialMotion, standing_wire
from lss_motion.planning.program.reference_grid import GRID_S, Reference, servo_limits
from lss_motion.planning.program.schedule import RELAXED_RATIOS, Schedule, overload_error, slot_us
from lss_motion.planning.program.verify import verify_profiles
from lss_motion.robot.profile import Profile, profile_lead_s, ramp_deg_s2
from lss_motion.units import s_from_ms, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.planning.program.response import PiecewiseProfile
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot

HISTORY_S: Final = 1.0
"""Pieces of a profile that ended this long before a splice are dropped: longer than any lead."""


class Extension(Struct, frozen=True, kw_only=True):
    """Moves that replace all those of a program that are due at or after `from_us`.

    Show time; `duration_s` is the instant at which the last horn arrives, `profiles` are the
    profiles from the splice on.
    """

    from_us: int
    moves: Sequence[Move]
    duration_s: float
    profiles: Mapping[str, PiecewiseProfile]
    line_use: Mapping[str, LineUse]
    tolerance_deg: float


class SpliceState(Struct, frozen=True, kw_only=True, dict=True):
    """The program up to and including its last extension; immutable: `taken` returns a new one."""

    robot: Robot
    tolerance_deg: float
    profiles: Mapping[str, Profile]
    """The profiles of the servos after all moves before the last splice."""
    moves: Sequence[Move] = ()
    """The moves from the last splice on."""
    duration_s: float = 0.0

    @cached_property
    def _lead_s(self) -> float:
        return splice_lead_s(self.robot, self.profiles)

    def extended(self, trajectory: Trajectory, *, starts_s: float, from_s: float) -> Extension:
        """Return the extension that follows `trajectory` from show time `from_s` on.

        The trajectory starts at show time `starts_s`; until `from_s` it is what is played already,
        and it ends at rest. Raises `LineLoadError` if the line cannot carry it at any tolerance.
        """
        if missing := [name for name in trajectory.joints if name not in self.profiles]:
            raise InputError(f"joint {missing[0]!r} is not one of the program's")
        splice_us = us_from_s(from_s - self._lead_s)
        references = self._references(trajectory, starts_s, s_from_us(splice_us))
        spliced = self.at(splice_us)
        initial = {
            name: InitialMotion(
                spliced[name].copy(),
                None if _stands(spliced[name], s_from_us(splice_us))
                else self.takes_over_s(name, splice_us),
            )
            for name in references
        }  # fmt: skip
        tight: Schedule | None = None
        for ratio in RELAXED_RATIOS:
            lines = {bus: _line(self, bus, splice_us) for bus in self.robot.buses}
            schedule = Schedule(
                references, self.robot, self.tolerance_deg * ratio, initial=initial, lines=lines
            )
            if not schedule.is_tight:
                return _extension(schedule, self.robot, splice_us, starts_s + trajectory.duration_s)
            tight = schedule
        assert tight is not None
        raise overload_error(
            tight,
            self.robot,
            from_s=s_from_us(splice_us),
            what="this part of the motion",
            remedies="a faster baud rate or a slower gait",
        )

    def taken(self, extension: Extension) -> SpliceState:
        """Return the state of the program after the player has accepted `extension`."""
        return replace(
            self,
            profiles=self.at(extension.from_us),
            moves=extension.moves,
            duration_s=extension.duration_s,
        )

    def at(self, splice_us: int) -> dict[str, Profile]:
        """Return the profiles after the moves that are due before `splice_us`."""
        by_address = {
            (joint.bus, joint.servo_id): name
            for name in self.profiles
            for joint in (self.robot.joints[name],)
        }
        profiles = {name: profile.copy() for name, profile in self.profiles.items()}
        for move in self.moves:
            if move.due_us >= splice_us:
                break
            name = by_address[move.bus, move.servo_id]
            received_s = s_from_us(received_us(move, self.robot.buses[move.bus].baud_bps))
            angle = target_deg(self.robot.joints[name], move.target_wire)
            profiles[name].retarget(received_s, angle, s_from_ms(move.duration_ms or 0))
        for profile in profiles.values():
            profile.forget_before(s_from_us(splice_us) - HISTORY_S)
        return profiles

    def takes_over_s(self, name: str, splice_us: int) -> float:
        """Return the latest receipt of the first move after a splice, for a joint in motion.

        This is the instant of its next move in the old program, or before the plan changes.
        """
        joint = self.robot.joints[name]
        changes_s = s_from_us(splice_us) + self._lead_s - profile_lead_s(joint)
        for move in self.moves:
            if move.due_us >= splice_us and (move.bus, move.servo_id) == (
                joint.bus,
                joint.servo_id,
            ):
                return min(
                    s_from_us(received_us(move, self.robot.buses[joint.bus].baud_bps)), changes_s
                )
        return changes_s

    def _references(
        self, trajectory: Trajectory, starts_s: float, splice_s: float
    ) -> dict[str, Reference]:
        """Return what the profiles have to do from the splice on."""
        end_s = starts_s + trajectory.duration_s
        steps = int(np.ceil((end_s - splice_s) / GRID_S)) + round(self._lead_s / GRID_S) + 2
        times_s = splice_s - starts_s + GRID_S * np.arange(steps, dtype=np.float64)
        references = {}
        for column, name in enumerate(trajectory.joints):
            joint = self.robot.joints[name]
            angles_deg = trajectory.sample(times_s + profile_lead_s(joint))[:, column]
            servo_deg = joint.zero_deg + joint.direction * angles_deg
            references[name] = Reference(start_s=splice_s, position_deg=servo_deg)
        return references


def initial_splice_state(program: Program, robot: Robot) -> SpliceState:
    """Return the state of a program that has no moves yet: every joint stands.

    Raises `InputError` for a joint that is not timed.
    """
    profiles = {}
    for name, joint_deg in program.start_deg.items():
        joint = robot.joints[name]
        if joint.drive != "timed":
            raise InputError(f"joint {name!r} is {joint.drive}; only timed joints are steered live")
        limits = servo_limits(joint, program.tolerance_deg)
        profiles[name] = Profile(
            standing_wire(joint.servo_deg(joint_deg), limits) / limits.wire_per_deg,
            ramp_deg_s2=ramp_deg_s2(joint),
            speed_max_deg_s=joint.speed_max_deg_s,
            response=joint.response,
        )
    return SpliceState(robot=robot, tolerance_deg=program.tolerance_deg, profiles=profiles)


def splice_lead_s(robot: Robot, names: Mapping[str, Profile]) -> float:
    """Return how long before a change of the plan the splice must be.

    Servos are sent their moves early, by their lag, and one after the other.
    """
    joints = [robot.joints[name] for name in names]
    queue_us = max(
        sum(slot_us(joint, robot) for joint in joints if joint.bus == bus.name)
        for bus in robot.buses.values()
    )
    return max(profile_lead_s(joint) for joint in joints) + s_from_us(queue_us) + GRID_S


def _extension(schedule: Schedule, robot: Robot, splice_us: int, duration_s: float) -> Extension:
    """Return the extension of a schedule; raises `PlanningError` if its bytes break a limit."""
    profiles = {name: fitted.profile for name, fitted in schedule.fitted.items()}
    verify_profiles(profiles, robot)
    moves = moves_of(schedule.fitted, robot)
    return Extension(
        from_us=splice_us,
        moves=moves,
        duration_s=duration_s,
        profiles=profiles,
        line_use=lines_use(moves, robot),
        tolerance_deg=schedule.tolerance_deg,
    )


def _line(splice_state: SpliceState, bus: str, splice_us: int) -> LineSchedule:
    """Return the line at a splice, on which the last move before it may still be sent."""
    schedule = LineSchedule()
    ends_us = [
        received_us(move, splice_state.robot.buses[bus].baud_bps)
        for move in splice_state.moves
        if move.bus == bus and move.due_us < splice_us
    ]
    if ends_us and ends_us[-1] > splice_us:
        schedule.reserve(ends_us[-1], ends_us[-1] - splice_us, splice_us)
    return schedule


def _stands(profile: Profile, at_s: float) -> bool:
    """Return whether a profile has come to rest for good."""
    *_, last = profile.pieces()
    return last.start_s <= at_s
