"""What `lss-play` does about sounds: the offset that a person found by ear, and what was silent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from lss_motion.playing.sound_choice import SoundChoice, SoundReport
    from lss_motion.robot.model import Robot


def with_kept_offset(robot: Robot) -> Robot:
    """Return the robot with the offset that was kept with the key k, if its file states none."""
    from lss_motion.robot.model import learnt_path

    if robot.path is None or robot.sound_offset_s or not learnt_path(robot.path).exists():
        return robot
    from lss_motion.robot.learnt import load_learnt

    try:
        kept_s = load_learnt(robot).sound_offset_s
    except InputError:  # `careful.Learning` has named what is wrong with the file.
        return robot
    return replace(robot, sound_offset_s=kept_s) if kept_s else robot


def offset_lines(robot: Robot, sound: SoundChoice) -> list[str]:
    """Keep the offset if this was requested; return what a person must know about it.

    `robot` is that of the robot file, without what was kept before.
    """
    if not sound.shift_s and not sound.is_kept:
        return []
    from lss_motion.robot.learnt import load_learnt, save_learnt
    from lss_motion.robot.model import learnt_path

    offset_s = round(with_kept_offset(robot).sound_offset_s + sound.shift_s, 4)
    by_hand = f"sound_offset_s: {offset_s:g} in the robot file"
    if not sound.is_kept:
        return [f"the sounds were shifted to {offset_s:g} s; to keep that: key k, or {by_hand}"]
    if robot.sound_offset_s or robot.path is None:
        return [f"the robot file states its own sound_offset_s; to change it: {by_hand}"]
    try:
        learnt = load_learnt(robot).model_copy(update={"sound_offset_s": offset_s})
        save_learnt(learnt, robot)
    except InputError as error:
        return [f"warning: the offset of the sounds is not kept: {error}; give {by_hand}"]
    return [f"the sounds stay at {offset_s:g} s: kept in {learnt_path(robot.path).name}"]


def unplayed_lines(sound: SoundReport | None) -> list[str]:
    """Return which sounds were not played, although the show was."""
    if sound is None or not sound.not_played:
        return []
    return [f"not played: {', '.join(sound.not_played)}"]
