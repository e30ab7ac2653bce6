"""The keys of `lss-motion record`, and what is seen meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.hands import HandsControls
from lss_motion.cli.joint_screen import joint_lines
from lss_motion.player.events import Phase
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.maintenance.take import Take

KEYS: Final = "l limp/hold  r record  p pose  u undo  q write and end"
RATE_NS: Final = NS_PER_S
"""Readings are counted over so long for the rate that is shown."""


class RecordControls(HandsControls):
    """Fills `take` from what is read; with `seconds`, lets go and records by itself."""

    def __init__(self, take: Take, *, seconds: float | None = None) -> None:
        super().__init__()
        self._take_of_hand = take
        self._seconds = seconds
        self._end_ns: int | None = None
        self._count = 0
        self._rate_hz = 0.0
        self._counted_ns = 0

    def begin(self, hands_on: HandsOn) -> None:
        if self._seconds is not None:
            hands_on.let_go(j.name for j in hands_on.joints)
            self._take_of_hand.start(self.now_ns)
            self._end_ns = self.now_ns + ns_from_s(self._seconds)
        elif not self.has_keys:
            self.say("no terminal to press keys on: give --seconds")
            hands_on.stop()
        else:
            self.say(f"hold the robot, then press l to let it go. {KEYS}")

    def turn(self, hands_on: HandsOn) -> None:
        fresh = hands_on.take()
        self._take_of_hand.add(fresh)
        self._count += len(fresh)
        if self.now_ns - self._counted_ns >= RATE_NS:
            self._rate_hz = self._count * NS_PER_S / (self.now_ns - self._counted_ns)
            self._count, self._counted_ns = 0, self.now_ns
        if self._end_ns is not None and self.now_ns >= self._end_ns:
            self._end_ns = None
            self._take_of_hand.finish()
            hands_on.stop()

    def press(self, key: str, hands_on: HandsOn) -> None:
        take, names = self._take_of_hand, [joint.name for joint in hands_on.joints]
        match key:
            case "l":
                if hands_on.limp:
                    hands_on.hold(names)
                    self.say("holding")
                else:
                    hands_on.let_go(names)
                    self.say("let go")
            case "r" if take.running is None:
                take.start(self.now_ns)
                self.say("recording")
            case "r":
                take.finish()
                self.say(f"recorded, {take.recorded_s:.1f} s in all")
            case "p" if take.running is not None:
                self.say("recording; press r first to end it")
            case "p":
                take.drop({name: hands_on.readings[name].deg for name in names})
                self.say(f"pose {len(take.parts)}")
            case "u":
                self.say("forgotten" if take.undo() else "there is nothing to forget")
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        take = self._take_of_hand
        state = "RECORDING" if take.running is not None else f"{len(take.parts)} parts"
        per_joint_hz = self._rate_hz / len(hands_on.joints)
        head = f"{state}  {take.recorded_s:.1f} s  {per_joint_hz:.0f} readings/s a joint   {KEYS}"
        return [head, *joint_lines(hands_on, now_ns)]
