"""A robot in a person's hands: joints limp, held or moved, their angles read without a pause.

For the runner, as a `Player` is, with the same endings: whatever happens, servos hold where they
are and get their settings back. A joint that is let go falls; the caller asks first.

Phases: connect (who is there?), prepare (the joint's limits for the session, as for a show), show
(the person's part), restore, done.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, LssMotionError
from lss_motion.maintenance.polling import IDLE_NS, Poller
from lss_motion.player import settings, setup
from lss_motion.player.dialogue import Dialogue, Item
from lss_motion.player.events import Event, Phase, PhaseEntered, Warned
from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.family import Family
from lss_motion.protocol.line import Command
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.maintenance.polling import Reading
    from lss_motion.player.settings import Answers
    from lss_motion.robot.model import Joint, Robot

SOFT: Final[Mapping[str, int]] = {"AH": -10, "AS": -4}
"""Session settings with which a hand can push a holding joint: the softest that the documents
allow (FACTS.md M24, M25). How soft that is, no document says."""

GIVE_WAY_DEG: Final = 1.0
"""A soft joint that was pushed this far is sent to where it is, within its range: what H does to a
horn that was pushed, no document says. Chosen: above backlash and noise."""

GIVE_WAY_S: Final = 0.02


class HandsOn:
    """Joints of `robot` in somebody's hands until `stop`; `error` says why it could not begin.

    With `is_soft`, joints that hold do so softly, and stay where a hand pushes them. What was
    answered to `also_ask`, queries for every joint, `answered` tells from the show on.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        *,
        is_soft: bool = False,
        also_ask: Sequence[str] = (),
    ) -> None:
        self.robot = robot
        self.joints = [_session(robot, name, is_soft=is_soft) for name in joints]
        self.phase = Phase.CONNECT
        self.error: LssMotionError | None = None
        self.limp: set[str] = set()
        self.lines = {name: Line(robot.buses[name]) for name in robot.buses}
        self._is_soft = is_soft
        self._held_deg: dict[str, float] = {}
        self._questioners = {name: Questioner(line) for name, line in self.lines.items()}
        self._poller = Poller(robot, self.joints, self.lines, self._questioners)
        self._events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self._answers: Answers = {}
        more = [
            Item(bus=joint.bus, command=Command(joint.servo_id, keyword), is_question=True)
            for joint in self.joints
            for keyword in also_ask
        ]
        self._dialogue: Dialogue | None = self._ask([*setup.questions(self.joints), *more])
        self._has_set = self._has_acted = False
        self._stops = 0
        self._now_ns = 0

    # ---- the four calls of the runner, and the last bytes

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        self._now_ns = now_ns
        while self._dialogue is not None:
            self._dialogue.advance(now_ns)
            if not self._dialogue.is_finished:
                break
            self._after_dialogue(now_ns)
        if self.phase is Phase.SHOW:
            self._poller.advance(now_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take in bytes of a bus. No byte of any kind raises."""
        for reply in self.lines[bus].receive(data):
            if self._dialogue is not None:
                self._dialogue.receive(bus, reply, now_ns)
            elif self.phase is Phase.SHOW:
                self._poller.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        if self.phase is Phase.DONE:
            return None
        if self._dialogue is None:
            return self._poller.next_wakeup_ns(self._now_ns)
        wakeup_ns = self._dialogue.next_wakeup_ns()
        return self._now_ns + IDLE_NS if wakeup_ns is None else max(wakeup_ns, self._now_ns)

    def next_event(self) -> Event | None:
        if self._events:
            return self._events.popleft()
        return self._poller.faults.popleft() if self._poller.faults else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes if it ends here: hold, if any servo was let go, held or moved."""
        return setup.safe_bytes(self.robot) if self._has_acted else {}

    # ---- what a person may ask for

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The latest reading of each joint; all are there from the show on."""
        return self._poller.readings

    def take(self) -> list[Reading]:
        """Return what was read since the last call, oldest first."""
        fresh = self._poller.take()
        if self._is_soft:
            self._give_way(fresh)
        return fresh

    @property
    def has_sent_all(self) -> bool:
        """Whether no order waits for its place on the line."""
        return not self._poller.has_orders

    def answered(self, name: str, keyword: str) -> int | None:
        """Return the number (wire unit) that a joint's servo answered, if it did."""
        joint = self.robot.joints[name]
        value = self._answers.get((joint.bus, joint.servo_id, keyword))
        return value if isinstance(value, int) else None

    def set(self, name: str, keyword: str, value: int) -> None:
        """Set something of a joint's servo (wire unit) that no ending takes back."""
        for joint in self._ready([name]):
            self._poller.order(joint, Command(joint.servo_id, keyword, value))

    def let_go(self, joints: Iterable[str]) -> None:
        """Take the power off joints: they fall if nobody holds them."""
        for joint in self._ready(joints):
            self._poller.order(joint, Command(joint.servo_id, "L"))
            self.limp.add(joint.name)

    def hold(self, joints: Iterable[str]) -> None:
        """Let joints keep the angle that they have when they hear it."""
        for joint in self._ready(joints):
            self._poller.order(joint, Command(joint.servo_id, "H"))
            self._held_deg[joint.name] = self.readings[joint.name].deg
            self.limp.discard(joint.name)

    def move(self, name: str, joint_deg: float, duration_s: float) -> float:
        """Move a joint by its own profile; return the target, which is kept within its range."""
        target_deg = joint_deg
        for joint in self._ready([name]):
            target_deg = min(max(joint_deg, joint.position_min_deg), joint.position_max_deg)
            command = make_command(
                joint.model.family,
                joint.servo_id,
                "D",
                joint.servo_deg(target_deg),
                {"T": float(max(1, math.ceil(duration_s * MS_PER_S)))},
            )
            self._poller.order(joint, command)
            self.limp.discard(name)
        return target_deg

    def stop(self) -> None:
        """Hold, give the settings back and end. Asked twice: end at once, holding."""
        self._stops += 1
        if self.phase is Phase.RESTORE and self._stops > 1:
            self._finish(self._now_ns)
        elif self.phase not in (Phase.RESTORE, Phase.DONE):
            self._restore()

    # ---- phases

    def _after_dialogue(self, now_ns: int) -> None:
        assert self._dialogue is not None
        self._answers = {**self._answers, **self._dialogue.answers}
        self._dialogue = None
        match self.phase:
            case Phase.CONNECT:
                self._connected()
            case Phase.PREPARE:
                for joint in self.joints:
                    angle_deg = settings.stored(joint, self._answers, "QD")
                    assert angle_deg is not None, "essential, so it was answered"
                    self._poller.note(joint, now_ns, angle_deg)
                self._enter(Phase.SHOW)
            case _:
                self._finish(now_ns)

    def _connected(self) -> None:
        try:
            for text in setup.check_answers(self.joints, self._answers, self.robot):
                self._events.append(Warned(text))
        except LssMotionError as error:
            self.error = error
            self._restore()
            return
        self._has_set = True
        self._enter(Phase.PREPARE)
        orders = settings.session_orders(self.joints, self._answers)
        orders += settings.unsure_orders(self.joints, self._answers)
        self._dialogue = self._ask([*setup.settings_questions(self.joints), *orders])

    def _restore(self) -> None:
        if self._dialogue is not None:
            self._answers = {**self._answers, **self._dialogue.answers}
        self._enter(Phase.RESTORE)
        orders: list[Item] = []
        if self._has_acted:
            orders += [
                Item(bus=joint.bus, command=Command(joint.servo_id, "H"), is_question=False)
                for joint in self.joints
            ]
        if self._has_set:
            orders += settings.restoring_orders(self.joints, self._answers)
        self._dialogue = self._ask(orders)

    def _finish(self, now_ns: int) -> None:
        self._dialogue = None
        self.limp.clear()
        for name, data in self.safe_bytes().items():
            self.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._events.append(PhaseEntered(phase))

    def _ask(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self.lines, self._questioners)

    def _ready(self, joints: Iterable[str]) -> list[Joint]:
        if self.phase is not Phase.SHOW:
            return []
        self._has_acted = True
        return [self.robot.joints[name] for name in joints]

    def _give_way(self, fresh: Iterable[Reading]) -> None:
        """Let joints that were pushed hold where they are now."""
        for name, deg in {reading.joint: reading.deg for reading in fresh}.items():
            is_held = name in self._held_deg and name not in self.limp
            if is_held and abs(deg - self._held_deg[name]) > GIVE_WAY_DEG:
                self._held_deg[name] = self.move(name, deg, GIVE_WAY_S)


def _session(robot: Robot, name: str, *, is_soft: bool) -> Joint:
    """Return a joint with its settings for the session; one that cannot be read is refused."""
    joint = robot.joints[name]
    if joint.model.family is Family.IO2:
        raise InputError(
            f"joint {name!r} is on an {joint.model.name}, which does not know where its servos "
            "are; leave it out with --joints",
            path=robot.path,
        )
    return dataclasses.replace(joint, settings={**joint.settings, **(SOFT if is_soft else {})})
