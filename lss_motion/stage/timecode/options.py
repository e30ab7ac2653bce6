"""What a person asks for: which timecode is followed or sent, and how.

`--follow` and `--send` of `lss-play` and the key `sync` of a stage use the same words.
"""

from __future__ import annotations

import ipaddress
import math
from typing import Final, Literal, cast, get_args

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.stage.timecode import packets
from lss_motion.stage.timecode.timecode import (
    CODED,
    FPS_25,
    Rate,
    Start,
    read_rate,
    read_timecode,
)

FollowKind = Literal["ltc", "mtc", "artnet", "fpp"]
SendKind = Literal["ltc", "mtc", "artnet", "fpp", "osc"]
FOLLOW_WORDS: Final = "ltc[:DEVICE], mtc[:PORT], artnet[:ADDRESS] or fpp[:ADDRESS]"
SEND_WORDS: Final = "ltc[:DEVICE], mtc[:PORT], artnet:ADDRESS, fpp:ADDRESS or osc:HOST:PORT"
LOOPBACK: Final = "127.0.0.1"
ALLOWED_MAX: Final = 64
OFFSET_MAX_S: Final = 86400.0


class FollowSpec(Struct, frozen=True, kw_only=True):
    """One source of timecode.

    `name`: device or port. `allowed`: the addresses from which packets are taken.
    """

    kind: FollowKind
    name: str = ""
    allowed: tuple[str, ...] = (LOOPBACK,)
    rate: Rate | None = None
    """None: as measured or labelled."""
    start: Start = Start()
    freewheel_s: float = 2.0

    @property
    def is_loopback(self) -> bool:
        """Whether packets of this computer only are taken."""
        return all(ipaddress.ip_network(text, strict=False).is_loopback for text in self.allowed)


class SendSpec(Struct, frozen=True, kw_only=True):
    """One receiver of timecode; `name` is a device, a port, or an address."""

    kind: SendKind
    name: str = ""
    port: int = 0
    rate: Rate = FPS_25
    offset_s: float = 0.0
    show: str = ""
    """Name of the show, for receivers that are told one."""


def read_follow(
    text: str, *, rate: str | None = None, offset: str | float = 0.0, freewheel_s: float = 2.0
) -> FollowSpec:
    """Return the source that `text` names; raises `InputError`."""
    word, _, rest = text.partition(":")
    if word not in get_args(FollowKind):
        raise InputError(f"{text!r} is no source of timecode; give {FOLLOW_WORDS}")
    kind = cast("FollowKind", word)
    chosen = None if rate is None else read_rate(rate)
    is_network = kind in ("artnet", "fpp")
    if kind == "fpp" and rate is not None:
        raise InputError("FPP sends seconds: a frame rate has no meaning with it")
    return FollowSpec(
        kind=kind,
        name="" if is_network else rest,
        allowed=_allowed(rest) if is_network and rest else (LOOPBACK,),
        rate=chosen,
        start=read_start(offset, chosen),
        freewheel_s=freewheel_s,
    )


def read_send(text: str, *, rate: str | None = None, offset: str | float = 0.0) -> SendSpec:
    """Return the receiver that `text` names; raises `InputError`."""
    word, _, rest = text.partition(":")
    if word not in get_args(SendKind):
        raise InputError(f"{text!r} is no receiver of timecode; give {SEND_WORDS}")
    kind = cast("SendKind", word)
    chosen = FPS_25 if rate is None else read_rate(rate)
    if kind in ("mtc", "artnet") and chosen not in CODED:
        names = ", ".join(one.name for one in CODED)
        raise InputError(f"{word} cannot name {chosen.name} frames a second; give one of {names}")
    port = {"artnet": packets.ARTNET_PORT, "fpp": packets.FPP_PORT}.get(kind, 0)
    if kind in ("artnet", "fpp", "osc"):
        rest, port = _address(text, rest, port)
    start = read_start(offset, chosen)
    return SendSpec(kind=kind, name=rest, port=port, rate=chosen, offset_s=start.at_s(chosen))


def read_start(value: str | float, rate: Rate | None = None) -> Start:
    """Return the start that a number of seconds, or HH:MM:SS:FF, names; raises `InputError`."""
    if isinstance(value, str) and ":" in value:
        label = read_timecode(value)
        if rate is not None and not label.is_valid(rate):
            raise InputError(f"there is no frame {value} at {rate.name} frames a second")
        return Start(label=label)
    try:
        seconds = float(value)
    except ValueError:
        seconds = math.nan
    if not abs(seconds) <= OFFSET_MAX_S:
        raise InputError(
            f"{value!r} is no start in timecode; write HH:MM:SS:FF, as in 01:00:00:00, or seconds"
        )
    return Start(seconds)


def _allowed(text: str) -> tuple[str, ...]:
    """Return the addresses and networks of a list with commas."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts or len(parts) > ALLOWED_MAX:
        raise InputError(f"{text!r}: give 1 to {ALLOWED_MAX} addresses, with commas between")
    for part in parts:
        try:
            ipaddress.IPv4Network(part, strict=False)
        except ValueError:
            raise InputError(
                f"{part!r} is no address of a sender; write one as 192.168.1.20, or a network as "
                f"192.168.1.0/24"
            ) from None
    return tuple(parts)


def _address(text: str, rest: str, port: int) -> tuple[str, int]:
    host, _, number = rest.partition(":")
    if number or not port:
        if not number.isdigit() or not 0 < int(number) < 65536:
            raise InputError(f"{text!r}: write HOST:PORT, with a port from 1 to 65535")
        port = int(number)
    if not host:
        raise InputError(f"{text!r} names no address; give {SEND_WORDS}")
    return host, port
