"""Timecode in and out of `lss-play`: `--follow` and `--send`."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.options import number_from
from lss_motion.errors import InputError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import PlayerRequest
    from lss_motion.playing.player.following import FollowRule
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.runner import Controls
    from lss_motion.stage.timecode.source import TimecodeOut, TimecodeSource
    from lss_motion.stage.timecode.timecode import FollowSpec, SendSpec

    Turn = Callable[[Player, int], None]

FREEWHEEL_S: Final = 2.0
FREEWHEEL_MAX_S: Final = 3600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--follow",
        metavar="SOURCE",
        help="wait for timecode, and stay in step with it: ltc[:DEVICE] (sound input), mtc[:PORT] "
        "(MIDI), artnet[:ADDRESS] or fpp[:ADDRESS] (senders; this computer only, if not given)",
    )
    parser.add_argument(
        "--send",
        action="append",
        default=[],
        metavar="RECEIVER",
        help="send timecode of the show: ltc[:DEVICE], mtc[:PORT], artnet:ADDRESS, fpp:ADDRESS or "
        "osc:HOST:PORT; may be given several times",
    )
    parser.add_argument(
        "--rate-fps",
        metavar="RATE",
        help="of the timecode: 23.976, 24, 25, 29.97, 29.97df or 30 (default: as it comes; 25 is "
        "sent)",
    )
    parser.add_argument(
        "--offset-s",
        default="0",
        metavar="HH:MM:SS:FF|S",
        help="timecode at which the show begins: subtracted from what comes, added to what is sent "
        "(default 0)",
    )
    parser.add_argument(
        "--freewheel",
        type=number_from(0.1, FREEWHEEL_MAX_S, "seconds"),
        default=FREEWHEEL_S,
        metavar="S",
        help="with --follow: without timecode, go on for so long (default 2)",
    )
    parser.add_argument(
        "--lost",
        choices=("go_on", "hold"),
        default="go_on",
        help="with --follow: what to do then (default go_on)",
    )


def specs_of(arguments: argparse.Namespace) -> tuple[FollowSpec | None, list[SendSpec]]:
    """Return what is followed and sent; raises `InputError` for options that do not fit."""
    if arguments.follow is None and not arguments.send:
        if arguments.rate_fps is not None or arguments.offset_s != "0":
            raise InputError(
                "--rate-fps and --offset-s are for --follow or --send; give one of them"
            )
        return None, []
    from lss_motion.stage.timecode.timecode import read_follow, read_send

    if arguments.virtual:
        raise InputError("--virtual has no clock to share: not with --follow or --send")
    style: dict[str, Any] = {"rate": arguments.rate_fps, "offset": arguments.offset_s}
    sends = [read_send(text, **style) for text in arguments.send]
    if arguments.follow is None:
        return None, sends
    for option in ("start_s", "careful"):
        if getattr(arguments, option):
            name = {"start_s": "--from"}.get(option, f"--{option}")
            raise InputError(f"{name} has no meaning with --follow: the timecode says where to be")
    if arguments.follow.startswith("fpp"):
        style["rate"] = None if sends else arguments.rate_fps
    return read_follow(arguments.follow, **style, freewheel_s=arguments.freewheel), sends


class Link:
    """Timecode of one run: its controls, and what is called on each turn."""

    def __init__(
        self,
        source: TimecodeSource | None,
        outs: list[TimecodeOut],
        rule: FollowRule | None = None,
    ) -> None:
        from lss_motion.playing.player.following import Following

        self._source, self._outs = source, outs
        self.following = None if source is None else Following(rule)

    @property
    def is_over(self) -> bool:
        """Whether the timecode that was followed is gone, beyond the end of the show."""
        return self.following is not None and self.following.is_over

    def controls(
        self,
        inner: Controls[Player],
        tell: Callable[[str], None],
        note_request: Callable[[PlayerRequest, int], None] | None,
    ) -> Controls[Player]:
        """Return the controls of the run; `inner` are those of a person."""
        if self.following is None or self._source is None:
            return inner
        from lss_motion.stage.timecode.source import FollowControls

        if note_request is not None:
            self.following.note_request = note_request
        return FollowControls(self.following, self._source, inner=inner, tell=tell)

    def on_turn(self, inner: Turn | None) -> Turn | None:
        """Return what is called on each turn."""
        calls = [*([] if inner is None else [inner]), *(out.turn for out in self._outs)]
        if len(calls) < 2:
            return calls[0] if calls else None

        def turn(player: Player, now_ns: int) -> None:
            for call in calls:
                call(player, now_ns)

        return turn


@contextlib.contextmanager
def opened(
    arguments: argparse.Namespace, program: Program, tell: Callable[[str], None]
) -> Iterator[Link]:
    """Open what is followed and sent, if anything; raises `InputError`."""
    follow, sends = specs_of(arguments)
    if follow is None and not sends:
        yield Link(None, [])
        return
    from msgspec.structs import replace

    from lss_motion.playing.player.following import FollowRule, require_can_follow
    from lss_motion.stage.timecode.source import TimecodeOut, TimecodeSource

    with contextlib.ExitStack() as stack:
        source = None
        if follow is not None:
            require_can_follow(program)
            source = stack.enter_context(TimecodeSource(follow))
        outs = [stack.enter_context(TimecodeOut(replace(s, show=program.name))) for s in sends]
        for out in outs:
            tell(f"sends {out.text}")
        rule = FollowRule(freewheel_s=arguments.freewheel, lost=arguments.lost)
        yield Link(source, outs, rule)
