"""What a stage has done and refused, as records of its log; and what each cue has done so far.

Equal refusals that follow each other are counted: a storm of triggers does not fill the disk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from lss_motion.stage import orders
from lss_motion.stage.duty import Reason
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from datetime import datetime

    from lss_motion.stage.director import Director
    from lss_motion.stage.model import Stage

    Record = dict[str, Any]

REFUSED_NS: Final = 60 * NS_PER_S
"""Equal refusals are counted, and noted this often."""
REFUSALS_MAX: Final = 1000
"""Different refusals that are counted at a time."""


def must_restart(reason: str) -> tuple[str, str]:
    """Return kind and text of the record of newer files for which the stage must begin anew."""
    return "must_restart", f"new files; the stage begins anew: {reason}"


def renewed(changed: Iterable[str]) -> tuple[str, str]:
    """Return kind and text of the record of newer files with which the stage goes on."""
    names = ", ".join(sorted(changed))
    return "renewed", "new files are played from now on" + (f"; changed: {names}" if names else "")


@dataclass(slots=True)
class CueState:
    """What a cue has done so far."""

    fired: int = 0
    fired_ns: int | None = None
    refused: str = ""
    """Why it was refused since it has fired last."""


class Records:
    """The records of one stage; `write` gets each with the time of day that `wall` returns."""

    def __init__(
        self, stage: Stage, wall: Callable[[], datetime], write: Callable[[Record], None]
    ) -> None:
        self._stage, self._wall, self._write = stage, wall, write
        self._about: dict[str, CueState] = {cue.name: CueState() for cue in stage.cues}
        self._refusals: dict[tuple[str, str], list[int]] = {}
        self._counted_ns: int | None = None

    def renew(self, stage: Stage) -> None:
        """Go on with a newer stage file."""
        self._stage = stage
        for cue in stage.cues:
            self._about.setdefault(cue.name, CueState())

    def note(self, kind: str, text: str, **more: object) -> None:
        """Keep what happened, with the time of day."""
        wall = self._wall().astimezone(self._stage.zone)
        self._write(
            {"t": wall.isoformat(timespec="milliseconds"), "kind": kind, "text": text, **more}
        )

    def note_order(self, order: orders.Order | orders.Note, now_ns: int) -> None:
        """Keep what the director has noted or ordered."""
        match order:
            case orders.CueFired():
                about = self._about.setdefault(order.cue, CueState())
                about.fired, about.fired_ns, about.refused = about.fired + 1, now_ns, ""
                self.note("fired", order.text, cue=order.cue, what=order.what)
            case orders.CueRefused():
                self._count_refusal(order)
            case orders.ShowRefused():
                named = {"cue": order.cue, "show": order.show, "reason": order.reason}
                self.note("not_played", order.text, **named)
            case orders.ShowStarted():
                self.note("started", order.text, show=order.show, cause=order.cause)
            case orders.ShowEnded():
                self.note("ended", order.text, show=order.show, outcome=order.outcome)
            case orders.RestChanged():
                self.note("rest", order.text, reasons=list(order.reasons))
            case orders.Noted():
                self.note("note", order.text)
            case orders.Alert():
                self.note("alert", order.text, alert=order.kind)
            case _:
                pass

    def _count_refusal(self, order: orders.CueRefused) -> None:
        """Note a refusal; equal ones that follow are only counted for a while."""
        self._about.setdefault(order.cue, CueState()).refused = order.reason
        key = (order.cue, order.reason.partition(",")[0])
        if key in self._refusals or len(self._refusals) >= REFUSALS_MAX:
            self._refusals.setdefault(("others", "many refusals"), [0])
            self._refusals.get(key, self._refusals[("others", "many refusals")])[0] += 1
            return
        self._refusals[key] = [0]
        self.note("refused", order.text, cue=order.cue, reason=order.reason, count=1)

    def note_waiting(self, director: Director, now_ns: int) -> None:
        """Note the shows of cues that have fired, but are not played: the stage has ended."""
        for one in (*director.queue, *director.left):
            reason = "the stage has ended"
            self.note_order(
                orders.ShowRefused(cue=one.cue.name, show=one.show, reason=reason), now_ns
            )

    def note_counts(self, now_ns: int, *, is_last: bool = False) -> None:
        """Note how often cues were refused since the first time, once a minute."""
        if self._counted_ns is None:
            self._counted_ns = now_ns
        if not is_last and now_ns < self._counted_ns + REFUSED_NS:
            return
        self._counted_ns = now_ns
        for (cue, reason), (count,) in self._refusals.items():
            if count:
                text = f"cue {cue} refused {count} more times: {reason}"
                self.note("refused", text, cue=cue, reason=reason, count=count)
        self._refusals.clear()

    def state_of(self, director: Director, now_ns: int) -> Record:
        """Return what operators see of the director: fields of `playing.remote.stage_messages`."""
        main = director.main
        return {
            "show": None if main is None else main.show,
            "cause": "" if main is None else "idle" if main.cue is None else main.cue.name,
            "added": tuple(one.show for one in director.added),
            "queue": tuple(one.show for one in director.queue),
            "left": tuple(one.show for one in director.left),
            "next_go": director.next_go(),
            "reasons": tuple(director.duty.reasons.values()),
            "cues": tuple(
                {
                    "name": cue.name,
                    "on": cue.on.text,
                    "plays": ", ".join(cue.shows) or cue.deed or "",
                    "is_enabled": director.enabled[cue.name],
                    "fired": about.fired,
                    "last_fired_s": None
                    if about.fired_ns is None
                    else round(s_from_ns(now_ns - about.fired_ns), 1),
                    "refused": about.refused,
                }
                for cue in self._stage.cues
                for about in [self._about[cue.name]]
            ),
        }


def state_word(director: Director, before: str) -> str:
    """Return the state of a stage in a word; `before`: while its robot is not connected."""
    main = director.main
    if Reason.FAULT in director.duty.reasons:
        return "given_up"
    if not director.is_connected:
        return before
    is_idle = main is None or main.cue is None or main.is_ready
    if director.duty.reasons and is_idle:
        return "rests"
    return "idle" if is_idle else "plays"
