"""Timecode out of a stage: the show clock of the shows that play for cues.

The idle show and the way to the rest send nothing: between shows the timecode stands where the last
show was left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lss_motion.errors import InputError
from lss_motion.stage.timecode.options import read_send
from lss_motion.system.clock_leg import ClockLeg

if TYPE_CHECKING:
    import contextlib
    from collections.abc import Callable, Sequence

    from lss_motion.playing.player.player import Player
    from lss_motion.stage.model import SendOutput
    from lss_motion.stage.orders import Playing
    from lss_motion.stage.timecode.options import SendSpec


class Out(Protocol):
    """A receiver of timecode: a `stage.timecode.source.TimecodeOut`, or a test."""

    def send_clock(self, leg: ClockLeg, show: str) -> None:
        """Send the clock of a show from now on; the same leg again changes nothing."""


def spec_of(output: SendOutput) -> SendSpec:
    """Return the receiver that a stage file names; raises `InputError`."""
    rest = "" if output.output == "default" else f":{output.output}"
    return read_send(f"{output.kind}{rest}", rate=f"{output.rate_fps:g}", offset=output.offset_s)


def opened(
    outputs: Sequence[SendOutput], stack: contextlib.ExitStack, tell: Callable[[str], None]
) -> list[Out]:
    """Open the receivers; one that cannot be opened is named, and the stage plays without it."""
    from lss_motion.stage.timecode.source import TimecodeOut

    outs: list[Out] = []
    for output in outputs:
        try:
            out = stack.enter_context(TimecodeOut(spec_of(output)))
        except InputError as error:
            tell(f"{error}: the stage plays without it")
        else:
            tell(f"sends {out.text}")
            outs.append(out)
    return outs


class Sending:
    """Sends the show clock of one stage. `turn` is called on each turn of the player.

    A pause and a trim are in the legs of that clock; a receiver is told only of new ones.
    """

    def __init__(self, outs: Sequence[Out] = ()) -> None:
        self._outs = outs
        self._show = ""
        self._last_s = 0.0
        self._stands: ClockLeg | None = None

    def turn(self, player: Player, main: Playing | None, now_ns: int) -> None:
        """Send the clock of `main` if it plays for a cue; None: it has not begun."""
        if not self._outs:
            return
        if main is not None and main.cue is not None and player.show is not None:
            self._show, self._stands, leg = main.show, None, player.show.clock.leg
            # It is over a moment after its end, when the servos have arrived.
            self._last_s = min(player.show.show_s(now_ns), player.program.duration_s)
        elif self._show:
            self._stands = self._stands or ClockLeg(now_ns, self._last_s, 0.0, 0.0, 0)
            leg = self._stands
        else:
            return
        for out in self._outs:
            out.send_clock(leg, self._show)
