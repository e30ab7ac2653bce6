"""One seed: a show with faults in virtual time, judged by what was sent, received, and done."""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from campaign.allowances import (
    ACCEL_EXCESS,
    BODY_KINDS,
    GONE_KINDS,
    LAGS,
    LYING_KINDS,
    LYING_RATIO,
    MISSED_KINDS,
    NOTICE_S,
    RANGE_EXCESS_DEG,
    READ_BACK_S,
    RESTS_WITHIN_DEG,
    SPEED_EXCESS,
    STEP_NS,
    STOOD_NS,
    TELLING_S,
    UNNOTICED_RATIO,
    UNNOTICED_S,
    WINDOW,
    WORD_KINDS,
    is_moved_otherwise,
)
from campaign.any_show import any_show
from campaign.outside import objections_to
from campaign.random_faults import KINDS, mixed_faults, random_faults
from campaign.stale import lawless_ns
from campaign.three_shows import NAMES, RESUME_S, SLOW_BPS, Show, show, with_stored_limits
from campaign.witness import Act, HangError, Witness, random_acts
from lss_motion.errors import BusError
from lss_motion.planning.program.reference_grid import servo_limits
from lss_motion.playing.player.estimators import OFFSET_MAX_DEG
from lss_motion.playing.run import Observer, Result, perform
from lss_motion.sim.bus import servos_of
from lss_motion.sim.faults import INSTANT, REPLY_KINDS, RESTARTING, Fault, FaultKind
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint

MOVE: Final = re.compile(rb"#(\d+)D(-?\d+)(?:T\d+)?\r")
SAFE: Final = re.compile(rb"#254H\r(#\d+L\r)*$")
LIMP: Final = re.compile(rb"#254L\r$")

BLIND_REST: Final = 7
"""Of the seeds with all kinds, those with this remainder by ten are played without feedback."""

Judges = Literal["own", "independent", "both"]
"""That of the campaign, the one that shares no code with it (`tools/judge`), or both."""


@dataclass(frozen=True)
class Judged:
    """The outcome of a show, and the promises that were broken.

    `objections` are those of the independent judge (`tools/judge`), if it was asked.
    """

    outcome: str
    broken: tuple[str, ...]
    faults: tuple[Fault, ...]
    objections: tuple[str, ...] = ()


def judged(
    seed: int,
    *,
    is_any: bool = False,
    slow_bps: int = SLOW_BPS,
    is_mixed: bool = False,
    judges: Judges = "own",
) -> Judged:
    """Play one seed. Every fourth has only damaged answers, so that all of it can be judged.

    With `is_any`, robot and show come from the seed as well, and random keys are pressed. With
    `is_mixed`, the faults are of all kinds (`random_faults.mixed_faults`), every second seed is any
    show, and every tenth is played without feedback by servos that store the joints' limits.
    """
    is_any = is_any or (is_mixed and bool(seed % 2))
    named = NAMES[(seed // 2 if is_mixed else seed) % len(NAMES)]
    played = any_show(seed) if is_any else show(named, slow_bps)
    has_feedback = not is_mixed or seed % 10 != BLIND_REST
    if not has_feedback:
        played = replace(played, robot=with_stored_limits(played.robot))
    if is_mixed:
        faults = mixed_faults(seed, played.robot, played.program.duration_s)
        if not has_feedback:  # Simulated servos that store more are played with a warning.
            faults = tuple(fault for fault in faults if "SD" not in fault.settings)
    else:
        faults = random_faults(
            seed,
            servo_ids=[joint.servo_id for joint in played.robot.joints.values()],
            duration_s=played.program.duration_s + 1.0,
            kinds=REPLY_KINDS if seed % 4 == 3 else KINDS,
        )
    acts = random_acts(seed, played.program.duration_s) if is_any else ()
    return judged_with(played, faults, seed, acts, judges, has_feedback=has_feedback)


def judged_with(
    played: Show,
    faults: Sequence[Fault],
    seed: int,
    acts: Sequence[Act] = (),
    judges: Judges = "own",
    *,
    has_feedback: bool = True,
) -> Judged:
    """Play a show with `faults`; return what became of it, and the promises that it broke."""
    faults = tuple(faults)
    witness = Witness(list(acts))
    observer = Observer(controls=witness, make_tap=lambda _: witness)
    try:
        result = perform(
            played.program,
            played.robot,
            is_virtual=True,
            seed=seed,
            has_feedback=has_feedback,
            faults=faults,
            observer=observer,
        )
    except HangError as error:
        return Judged("hung", (f"it hangs: {error}",), faults)
    except BusError:  # Something let the port go before the player could open it.
        return Judged("unreachable", (), faults)
    except Exception as error:  # noqa: BLE001  (a crash of any kind is what is looked for)
        return Judged("crashed", (f"it crashed: {error!r}",), faults)
    for bus in result.simulated.values():
        bus.advance(witness.end_ns + NS_PER_S)  # What is on its way is received, and done.
    judge = _Judge(played, faults, witness, result, has_feedback=has_feedback)
    broken = [] if judges == "independent" else judge.broken()
    objections = [] if judges == "own" else objections_to(played.robot, faults, witness, result)
    return Judged(result.report.outcome, tuple(broken), faults, tuple(objections))


class _Judge:
    def __init__(
        self,
        played: Show,
        faults: Sequence[Fault],
        witness: Witness,
        result: Result,
        *,
        has_feedback: bool = True,
    ) -> None:
        self.robot, self.program = played.robot, played.program
        self.faults = faults
        self.has_feedback = has_feedback
        self.witness = witness
        self.result = result
        self.kinds = {fault.kind for fault in faults}
        self.sent = self._sent()
        self.targets = {name: [angle for _, angle in own] for name, own in self.sent.items()}

    def broken(self) -> list[str]:
        """Return every promise that was broken, in words."""
        return [
            *self._ranges(),
            *self._last_bytes(),
            *self._offsets(),
            *self._horns(),
            *(self._silences() if self.has_feedback else ()),
        ]

    def _sent(self) -> dict[str, list[tuple[int, float]]]:
        """Return when every joint was sent to which joint angles, in order."""
        names = {(joint.bus, joint.servo_id): name for name, joint in self.robot.joints.items()}
        sent: dict[str, list[tuple[int, float]]] = {name: [] for name in self.robot.joints}
        for bus, data in self.witness.sent_data.items():
            writes = self.witness.writes[bus]
            ends = [*accumulate(len(written) for _, written in writes)]
            for match in MOVE.finditer(bytes(data)):
                name = names[bus, int(match[1])]
                joint = self.robot.joints[name]
                angle = joint.joint_deg(int(match[2]) / joint.model.wire_per_deg)
                sent[name].append((writes[bisect_right(ends, match.start())][0], angle))
        return sent

    def _ranges(self) -> list[str]:
        broken = []
        for name, sent in self.sent.items():
            joint = self.robot.joints[name]
            if self._has_other_angles(joint):
                continue  # By what it reports it stands outside, and is led back.
            last_deg = 0.0
            for sent_ns, angle in sent:
                out_deg = _outside_deg(joint, angle)
                allowed_deg = max(joint.unit_deg, last_deg)
                if out_deg > allowed_deg and out_deg > self._stood_out_deg(joint, sent_ns):
                    broken.append(f"{name} was sent to {angle:.1f} deg")
                last_deg = out_deg
        return broken

    def _has_other_angles(self, joint: Joint) -> bool:
        return any(
            fault.kind is FaultKind.WRONG_SCALE and fault.setting == "D" and _shares(joint, fault)
            for fault in self.faults
        )

    def _stood_out_deg(self, joint: Joint, sent_ns: int) -> float:
        """Return how far outside of its range a horn just stood, put there by garbled bytes.

        A joint without T is led back from there step by step, none further out than the last.
        """
        if joint.drive == "timed" or not self.kinds & WORD_KINDS:
            return 0.0
        horn_deg = self._horn_deg(joint.bus)[joint.name]
        stood_deg = horn_deg[max(0, sent_ns - STOOD_NS) // STEP_NS : sent_ns // STEP_NS + 1]
        out_deg = max(_outside_deg(joint, float(angle)) for angle in stood_deg)
        return out_deg + RANGE_EXCESS_DEG if out_deg > 0.0 else 0.0

    def _last_bytes(self) -> list[str]:
        """Judge the last bytes on every bus whose port is there at the end."""
        end_s = s_from_ns(self.witness.end_ns)
        is_gone = any(
            fault.kind in GONE_KINDS and fault.until_s > end_s - 1.0 for fault in self.faults
        )
        is_limp = self.robot.end == "limp" and self.result.report.outcome == "finished"
        safe = LIMP if is_limp else SAFE
        is_garbled = bool(self.kinds & (WORD_KINDS | {FaultKind.LOST_COMMAND}))
        broken = []
        for bus, data in self.witness.sent_data.items():
            if not MOVE.search(bytes(data)) or is_gone or self._is_let_go(bus):
                continue
            if not safe.search(bytes(data)):
                broken.append(f"the last bytes on bus {bus} are {bytes(data[-20:])!r}")
            received = self.result.simulated[bus].lines
            assert received is not None, "perform records"
            others = {fault.text.encode() + b"\r" for fault in self.faults if fault.text}
            if others & {b"#254H\r", b"#254L\r"}:
                continue  # Both hosts send the same: no byte tells them apart.
            lines = b"".join(line for _, line in received if line not in others)
            if not is_garbled and not safe.search(lines):
                broken.append(f"the last that bus {bus} received is {lines[-20:]!r}")
        return broken

    def _is_let_go(self, bus: str) -> bool:
        """Return whether a port was gone at the end: an LSS-PRO that restarts takes it along."""
        outages_ns = self.result.simulated[bus].outages_ns()
        return any(until_ns > self.witness.end_ns - NS_PER_S for _, until_ns in outages_ns)

    def _offsets(self) -> list[str]:
        """Judge what damaged answers did to the moves of a show that played through.

        A correction lies between a move as it was planned and as it was sent, nothing else.
        """
        report = self.result.report
        if self.kinds - set(REPLY_KINDS) or report.faults or report.outcome != "finished":
            return []
        if self.witness.has_acted:
            return []
        broken = []
        for name, joint in self.robot.joints.items():
            if joint.drive != "timed":
                continue
            sent, most_deg = [*self.targets[name]], OFFSET_MAX_DEG + joint.unit_deg
            # What lies makes the player think that a move was lost: it is said again, in two parts;
            # or that a servo has restarted: its moves are held back, and the rest is sent then.
            spare = 2 * report.joints[name].resent
            rest, wrong = _unlike(sent, self._planned_deg(joint), most_deg)
            if rest > self._held_back(name) or wrong > spare:
                broken.append(f"{name}: {rest} moves of the plan were not sent, {wrong} others")
        return broken

    def _held_back(self, name: str) -> int:
        """Return how many moves were not sent since the servo might have restarted."""
        show = self.result.player.show
        return 0 if show is None else show.joint_states[name].held_back

    def _planned_deg(self, joint: Joint) -> list[float]:
        return [
            joint.joint_deg(move.target_wire / joint.model.wire_per_deg)
            for move in self.program.moves
            if (move.bus, move.servo_id) == (joint.bus, joint.servo_id)
        ]

    # ---- at the horns

    def _horns(self) -> list[str]:
        if self.kinds & WORD_KINDS:
            return []
        return [
            text
            for bus in self.result.simulated
            for name, angles in self._horn_deg(bus).items()
            if (joint := self.robot.joints[name]).drive != "stepped"
            and not self._is_of_its_own(joint)
            for text in self._horn(joint, angles)
        ]

    def _horn_deg(self, bus: str) -> dict[str, NDArray[np.float64]]:
        """Return the true joint angles of the horns of a bus, `STEP_NS` apart."""
        times_ns = np.arange(0, max(self.witness.end_ns, 20 * STEP_NS), STEP_NS)
        servo_deg = self.result.simulated[bus].horn_deg(times_ns)
        joints = [self.robot.joints[name] for name in servos_of(self.robot, bus)]
        return {
            joint.name: joint.direction * (servo_deg[:, column] - joint.zero_deg)
            for column, joint in enumerate(joints)
        }

    def _is_of_its_own(self, joint: Joint) -> bool:
        """Return whether a horn may move without a command, or otherwise than commanded."""
        if any(is_moved_otherwise(joint, fault) for fault in self.faults):
            return True
        is_streamed = joint.drive == "streamed"
        kinds = BODY_KINDS | (MISSED_KINDS if is_streamed else set())
        own = [fault for fault in self.faults if _shares(joint, fault)]
        is_lied_about = any(f.kind in LYING_KINDS and f.ratio >= LYING_RATIO for f in own)
        return any(f.kind in kinds for f in own) or (is_streamed and is_lied_about)

    def _horn(self, joint: Joint, angles: NDArray[np.float64]) -> list[str]:
        broken = []
        outside = [a for a in (angles.min(), angles.max()) if not _is_within(joint, float(a))]
        if outside:
            broken.append(f"the horn of {joint.name} came to {outside[0]:.1f} deg")
        span_s = s_from_ns(WINDOW * STEP_NS)
        speed = (angles[WINDOW:] - angles[:-WINDOW]) / span_s
        accel = (speed[WINDOW:] - speed[:-WINDOW]) / span_s
        writes = self.witness.writes.get(joint.bus, [])
        received = self.result.simulated[joint.bus].lines or []
        for instant_ns in self._powerless_ns(joint, received):
            # Without power a motor stops at once.
            at = instant_ns // STEP_NS
            accel[max(0, at - 2 * WINDOW) : at + WINDOW] = 0.0
        is_starved = FaultKind.OVERSLEEP in self.kinds or self._held_back(joint.name)
        if joint.drive == "streamed" and is_starved:
            for at in self._starved(joint, received):
                brakes = accel[at] * speed[: len(accel)][at] < 0.0
                accel[at] = np.where(brakes, 0.0, accel[at])
        for fault in self._restarts(joint):
            noticed_s = max(fault.at_s + NOTICE_S, fault.at_s + fault.deaf_s + READ_BACK_S)
            at = ns_from_s(fault.at_s) // STEP_NS
            accel[at : ns_from_s(noticed_s) // STEP_NS] = 0.0
            slow_s = fault.at_s + fault.deaf_s + UNNOTICED_S
            speed[at : ns_from_s(slow_s) // STEP_NS] /= UNNOTICED_RATIO
        lag_ns = ns_from_s(LAGS * joint.response.lag_s)
        for from_ns, until_ns in lawless_ns(joint.servo_id, self.faults, writes, received):
            first, last = from_ns // STEP_NS - 2 * WINDOW, (until_ns + lag_ns) // STEP_NS
            speed[max(0, first) : last] = accel[max(0, first) : last] = 0.0
        speed_deg_s = SPEED_EXCESS * joint.speed_max_deg_s
        accel_deg_s2 = joint.accel_max_deg_s2
        if joint.drive == "streamed":
            # From one step of a filter to the next, a course winds within its tolerance.
            tolerance_deg, filter_s = self.program.tolerance_deg, joint.response.filter_s
            accel_deg_s2 += servo_limits(joint, tolerance_deg).tolerance_deg / filter_s**2
        accel_deg_s2 *= ACCEL_EXCESS
        for what, values, limit, unit in (
            ("speed", speed, speed_deg_s, "deg/s"),
            ("acceleration", accel, accel_deg_s2, "deg/s²"),
        ):
            worst = int(np.abs(values).argmax())
            if abs(values[worst]) > limit:
                broken.append(
                    f"the horn of {joint.name} came to a {what} of {abs(values[worst]):.0f} {unit} "
                    f"at {worst * s_from_ns(STEP_NS):.2f} s, allowed is {limit:.0f}"
                )
        return broken + self._rest(joint, float(angles[-1]))

    def _starved(self, joint: Joint, received: Sequence[tuple[int, bytes]]) -> list[slice]:
        """Return when a filter had no new target in time: then it brakes by itself (FACTS.md M6).

        A host that wakes late can do nothing about that, nor one that must send no target since the
        servo has not answered and may have restarted.
        """
        period_ns = ns_from_s(joint.response.filter_s)
        lag_ns = ns_from_s(LAGS * joint.response.lag_s)
        word = b"#%dD" % joint.servo_id
        instants_ns = [at_ns for at_ns, line in received if line.startswith(word)]
        return [
            slice(
                max(0, (from_ns + period_ns) // STEP_NS - 2 * WINDOW),
                (to_ns + lag_ns) // STEP_NS,
            )
            for from_ns, to_ns in pairwise(instants_ns)
            if to_ns - from_ns > 1.5 * period_ns
        ]

    def _powerless_ns(self, joint: Joint, received: Sequence[tuple[int, bytes]]) -> list[int]:
        """Return when a servo restarted, or received that it is to be limp (`on_fault`, `end`)."""
        limp = (b"#%dL\r" % joint.servo_id, b"#254L\r")
        return [ns_from_s(fault.at_s) for fault in self._restarts(joint)] + [
            received_ns for received_ns, line in received if line in limp
        ]

    def _restarts(self, joint: Joint) -> list[Fault]:
        return [
            fault for fault in self.faults if fault.kind in RESTARTING and _shares(joint, fault)
        ]

    def _rest(self, joint: Joint, angle: float) -> list[str]:
        """Judge where a joint stands after a show that says that all went well."""
        report = self.result.report
        if report.outcome != "finished" or report.faults or not self.has_feedback:
            return []  # Without feedback nothing can be noticed.
        if any(self._is_telling_too_late(fault) for fault in self.faults):
            return []
        wanted_deg = [self.program.start_deg[joint.name], *self._planned_deg(joint)][-1]
        if abs(angle - wanted_deg) <= RESTS_WITHIN_DEG:
            return []
        return [f"{joint.name} rests at {angle:.1f} deg, not {wanted_deg:.1f}; nothing is said"]

    def _is_telling_too_late(self, fault: Fault) -> bool:
        """Return whether a fault comes too late to be found before the end."""
        end_s = s_from_ns(self.witness.end_ns)
        return fault.until_s > end_s - TELLING_S and fault.kind in MISSED_KINDS

    def _silences(self) -> list[str]:
        """Judge whether a servo that went deaf for good is named."""
        end_s = s_from_ns(self.witness.end_ns)
        named = {fault.joint for fault in self.result.report.faults}
        stalls = [f for f in self.faults if f.kind is FaultKind.OVERSLEEP and f.late_s > TELLING_S]
        asleep_s = sum(
            fault.late_s for fault in stalls
        )  # A host that stands still notices nothing.
        is_over = self.result.error is not None or "" in named
        return [
            f"{joint.name} has been deaf since {fault.at_s:.1f} s, and nothing is said"
            for fault in self.faults
            for joint in self.robot.joints.values()
            if fault.kind is FaultKind.DEAF
            and fault.kind not in INSTANT
            and fault.ratio >= 1.0
            and _shares(joint, fault)
            and joint.drive != "stepped"
            and min(fault.until_s, end_s) - fault.at_s - asleep_s > RESUME_S + TELLING_S
            and not named & {j.name for j in self.robot.joints.values() if _shares(j, fault)}
            and not is_over
        ]


def _shares(joint: Joint, fault: Fault) -> bool:
    return fault.servo_id in (None, joint.servo_id)


def _unlike(sent: Sequence[float], wanted: Sequence[float], most_deg: float) -> tuple[int, int]:
    """Return how many of `wanted` have no like in `sent`, and how many of `sent` come between.

    What was sent before the first of them is the approach.
    """
    row: list[tuple[int, int]] = [(0, 0)] * (len(sent) + 1)
    for wanted_deg in wanted:
        last, row = row, [(row[0][0] + 1, row[0][1])]
        for at, sent_deg in enumerate(sent):
            ways = [(last[at + 1][0] + 1, last[at + 1][1]), (row[at][0], row[at][1] + 1)]
            if abs(sent_deg - wanted_deg) <= most_deg:
                ways.append(last[at])
            row.append(min(ways, key=sum))
    return row[-1]


def _outside_deg(joint: Joint, angle: float) -> float:
    """Return how far outside of its range a joint angle is; 0 inside."""
    return max(joint.position_min_deg - angle, angle - joint.position_max_deg, 0.0)


def _is_within(joint: Joint, angle: float, excess_deg: float = RANGE_EXCESS_DEG) -> bool:
    return _outside_deg(joint, angle) <= excess_deg
