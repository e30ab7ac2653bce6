"""The steps of the hour: each measures one thing on an open connection, and returns figures.

Figures are numbers and words that JSON can hold, by name. A step raises `StoppedError` when a
person stopped the joint, and what the run raised when that failed; then it has no figures.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from msgspec import to_builtins

from lss_motion.errors import StoppedError
from lss_motion.maintenance.api import make_experiment, measurable
from lss_motion.maintenance.careful import way_of
from lss_motion.maintenance.field.runs import FilterMoves, SmallMoves, streamed
from lss_motion.maintenance.identify.estimate import MISFIT_LEAST_DEG, MISFIT_RATIO, identify
from lss_motion.maintenance.identify.trials import make_window
from lss_motion.playing.discovery import BusListening, DiscoveryStep
from lss_motion.playing.player import handshake
from lss_motion.playing.player.checks import reported_firmware, stored_excesses
from lss_motion.playing.player.handshake import Item
from lss_motion.playing.player.preflight import Examination
from lss_motion.protocol.constants import GROUP_FIRMWARE, status_from
from lss_motion.protocol.framing import Command, Reply, ReplyParser, encode_group
from lss_motion.robot.servo_models import FILTER_FIRMWARE_MIN
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.maintenance.identify.joint_run import JointRun
    from lss_motion.maintenance.identify.trials import Trial
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.runner import Controls
    from lss_motion.robot.model import Joint, Robot

    Figures: TypeAlias = "dict[str, Any]"
    """What a step has measured, as JSON can hold it."""

SIZES_DEG: Final = (5.0, 2.0, 0.5)
"""The sizes of small moves: that of a careful run, and two below it."""
GROUP_LINES: Final = 3
GROUP_LISTEN_NS: Final = 60_000_000
"""A group of 18 servos is answered in 12 ms at 921600 bps (FACTS.md W15), in 40 ms at 115200."""
ASK_EVERY_S: Final = 0.05
DEAF_MAX_S: Final = 6.0
"""A servo that is silent for longer after RESET does not come back. Libraries wait 3 s."""
AWAY_MAX_S: Final = 90.0
"""A person has so long to unplug a servo, and again to plug it in."""
SILENT_TIMES: Final = 3
"""A servo is gone after so many queries in a row without an answer: one may be lost."""


def _driven(connection: Connection, run: JointRun, controls: Controls[JointRun] | None) -> None:
    connection.run(run, controls=controls)
    if run.is_stopped:
        raise StoppedError(f"stopped at {run.joint.name}: it holds")
    if run.error is not None:
        raise run.error


def found_servos(connection: Connection, robot: Robot, joints: Sequence[Joint]) -> Figures:
    """Return what the preflight of a show finds; nothing moves. Raises where a show would not run.

    `excesses` are the limits that servos store and that are higher than those of their joints.
    """
    from lss_motion.playing.player import checks

    preflight = connection.run(Examination(joints, robot, reads_stored=True)).preflight
    preflight.require_own_ids()
    warnings = checks.check_answers(joints, preflight.answers, robot, stored=preflight.stored)
    return {
        "warnings": warnings,
        "excesses": stored_excesses(joints, preflight.stored),
        "firmware": {one.name: reported_firmware(one, preflight.answers) for one in joints},
        "model": {one.name: one.model.name for one in joints},
    }


def laws(
    connection: Connection,
    robot: Robot,
    joint: Joint,
    span_deg: float,
    controls: Controls[JointRun] | None = None,
) -> Figures:
    """Return what the experiment of `identify` finds, and whether its model explains it."""
    timed = measurable(robot, joint.name)
    experiment = make_experiment(connection, robot, timed, span_deg)
    _driven(connection, experiment, controls)
    found = identify(timed, experiment.recording)
    figures: Figures = to_builtins(found)
    figures["is_explained"] = is_explained(found)
    return figures


def is_explained(found: Identified) -> bool:
    """Return whether the model leaves no more than the scatter of the readings."""
    return found.misfit_deg <= MISFIT_RATIO * found.noise_deg + MISFIT_LEAST_DEG


def small_moves(
    connection: Connection, robot: Robot, joint: Joint, controls: Controls[JointRun] | None = None
) -> Figures:
    """Return how far the horn turned in moves of each of `SIZES_DEG`, and its status then."""
    timed = measurable(robot, joint.name)
    answers, standing_deg = _standing(connection, robot, timed)
    way_deg = way_of(timed, robot, standing_deg)
    sizes_deg = [math.copysign(min(size, abs(way_deg)), way_deg) for size in SIZES_DEG]
    sizes_deg = list(dict.fromkeys(sizes_deg))
    window = make_window(timed, standing_deg, 2.0 * max(SIZES_DEG))
    run = SmallMoves(timed, robot, answers, window, standing_deg=standing_deg, sizes_deg=sizes_deg)
    _driven(connection, run, controls)
    moves = [
        {
            "size_deg": abs(size_deg),
            "turned_deg": [abs(turned) for turned in _turned_deg(run.trials_of(size_deg))],
        }
        for size_deg in sizes_deg
    ]
    return {"moves": moves, "status": _status(connection, timed, answers)}


def _standing(
    connection: Connection, robot: Robot, joint: Joint
) -> tuple[handshake.Answers, float]:
    answers, _ = connection.examined([joint], robot)
    standing_deg = handshake.reported(joint, answers, "QD")
    assert standing_deg is not None, "`examined` raises without it"
    return answers, standing_deg


def _turned_deg(trials: Sequence[Trial]) -> list[float]:
    """Return by how much each move but the first turned the horn, from rest to rest.

    The first comes from an angle that the play of the gears leaves open.
    """
    rests_deg = [trial.rest_deg() for trial in trials]
    return [after - before for before, after in pairwise(rests_deg)]


def _status(connection: Connection, joint: Joint, answers: handshake.Answers) -> str:
    code = connection.ask([Item.to(joint, "Q")]).get((joint.bus, joint.servo_id, "Q"))
    firmware = reported_firmware(joint, answers)
    status = status_from(code, joint.model.family, firmware) if isinstance(code, int) else None
    return "" if status is None else status.name


def filtered(
    connection: Connection, robot: Robot, joint: Joint, controls: Controls[JointRun] | None = None
) -> Figures:
    """Return how late the horn is in EM0 for moves through the filter; {} without a filter.

    `late_s` is the mean over all moves of the time by which the way is late: for a filter that
    takes a share of 1 / FPC every period, FPC periods less the one in which the command comes.
    """
    timed = measurable(robot, joint.name)
    answers, standing_deg = _standing(connection, robot, timed)
    firmware = reported_firmware(timed, answers)
    way_deg = way_of(timed, robot, standing_deg)
    if firmware is None or firmware < FILTER_FIRMWARE_MIN or not way_deg:
        return {}
    filtering = streamed(timed, robot, way_deg)
    answers, standing_deg = _standing(connection, robot, filtering)
    window = make_window(timed, standing_deg, 2.0 * abs(way_deg))
    run = FilterMoves(
        filtering, robot, answers, window, standing_deg=standing_deg, sizes_deg=(way_deg,)
    )
    _driven(connection, run, controls)
    trials = run.recording.trials
    lates_s = [late_s(trial, before.rest_deg()) for before, trial in pairwise(trials)]
    return {"filter_count": filtering.filter_count, "late_s": lates_s}


def late_s(trial: Trial, begin_deg: float) -> float:
    """Return by how much the way of a trial is late, on average over the way."""
    end_deg = trial.rest_deg()
    times_s = np.array(trial.times_s) - trial.sent[0].received_s
    left = (end_deg - np.array(trial.readings_deg)) / (end_deg - begin_deg)
    is_after = times_s > 0.0
    times_s = np.concatenate([[0.0], times_s[is_after]])
    left = np.concatenate([[1.0], left[is_after]])
    return float(np.sum(0.5 * (left[1:] + left[:-1]) * np.diff(times_s)))


def group_replies(connection: Connection, robot: Robot, joints: Sequence[Joint]) -> Figures:
    """Return for each bus with two servos of firmware 370 whether a group line is answered.

    The servos answer in the order of the line (FACTS.md W17), one of three lines may be damaged.
    """
    answers, _ = connection.examined(joints, robot)
    found: Figures = {}
    for name in dict.fromkeys(joint.bus for joint in joints):
        able = [
            joint.servo_id
            for joint in joints
            if joint.bus == name and (reported_firmware(joint, answers) or 0) >= GROUP_FIRMWARE
        ]
        if len(able) < 2:
            continue
        line = encode_group([Command(servo_id, "QD") for servo_id in able])
        steps = [DiscoveryStep(line, GROUP_LISTEN_NS)] * GROUP_LINES
        listening = connection.run(BusListening(name, steps))
        told = [
            [
                item.servo_id
                for item in ReplyParser(grouped=True).feed(data)
                if isinstance(item, Reply) and item.keyword == "QD"
            ]
            for data in listening.received
        ]
        found[name] = {"asked": able, "answered": told}
    return found


def restart(connection: Connection, joint: Joint) -> Figures:
    """Restart a servo; return how long it was deaf, and its status and mode then. It goes limp."""
    before = connection.ask([Item.to(joint, "QF")])
    connection.ask([Item.to(joint, "RESET")])
    began_ns = connection.clock.now_ns()
    until_ns = began_ns + int(DEAF_MAX_S * NS_PER_S)
    while connection.clock.now_ns() < until_ns:
        if _answers(connection, joint):
            deaf_s = s_from_ns(connection.clock.now_ns() - began_ns)
            return {"deaf_s": deaf_s, **_began(connection, joint, before)}
        connection.wait(ASK_EVERY_S)
    return {}


def _answers(connection: Connection, joint: Joint) -> bool:
    command = Command(joint.servo_id, "Q")
    answers = connection.ask([Item(bus=joint.bus, command=command, tries=1)])
    return (joint.bus, joint.servo_id, "Q") in answers


def unplugged(connection: Connection, joint: Joint) -> Figures:
    """Wait until a person has unplugged a servo and plugged it in; {} if it never was away."""
    before = connection.ask([Item.to(joint, "QF")])
    began_ns = connection.clock.now_ns()
    silent = 0
    while silent < SILENT_TIMES:
        silent = 0 if _answers(connection, joint) else silent + 1
        if connection.clock.now_ns() - began_ns > AWAY_MAX_S * NS_PER_S:
            return {}
        connection.wait(ASK_EVERY_S)
    gone_ns = connection.clock.now_ns()
    while not _answers(connection, joint):
        if connection.clock.now_ns() - gone_ns > AWAY_MAX_S * NS_PER_S:
            return {}
        connection.wait(ASK_EVERY_S)
    away_s = s_from_ns(connection.clock.now_ns() - gone_ns)
    return {"away_s": away_s, **_began(connection, joint, before)}


def _began(connection: Connection, joint: Joint, before: handshake.Answers) -> Figures:
    """Return the state of a servo that has just begun, and whether it stores a first position."""
    answers = connection.ask([Item.to(joint, "QFD")])
    first = answers.get((joint.bus, joint.servo_id, "QFD"))
    return {
        "status": _status(connection, joint, before),
        "has_first": isinstance(first, int),
    }
