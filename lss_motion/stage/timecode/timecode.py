"""Timecode: hours, minutes, seconds and frames as labels, and what they are in seconds.

Labels are counted in whole frames a second (`FrameRate.labels`). At 23.976 and 29.97 frames a
second a label second lasts 1.001 s. Drop-frame leaves out the labels of frames 0 and 1 in each
minute but every tenth, so that labels and seconds agree to within 0.1 s over a day (SMPTE 12M).

`FollowSpec` and `SendSpec` are which timecode a person wants followed or sent: `--follow` and
`--send` of `lss-play` and the key `sync` of a stage use the same words.
"""

from __future__ import annotations

import ipaddress
import math
import re
from pathlib import PurePosixPath
from typing import Final, Literal, NamedTuple, cast, get_args

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names

ARTNET_PORT: Final = 6454
FPP_PORT: Final = 32320
HOURS: Final = 24
DROPPED: Final = 2
"""Labels that drop-frame leaves out in nine of ten minutes."""


class FrameRate(Struct, frozen=True):
    """How many frames a second has, and how they are labelled."""

    name: str
    labels: int
    frames_per_s: float
    is_drop: bool = False

    @property
    def frames_per_day(self) -> int:
        minutes = 60 * HOURS
        dropped = DROPPED * (minutes - minutes // 10) if self.is_drop else 0
        return minutes * 60 * self.labels - dropped


FPS_23_976: Final = FrameRate("23.976", 24, 24000 / 1001)
FPS_24: Final = FrameRate("24", 24, 24.0)
FPS_25: Final = FrameRate("25", 25, 25.0)
FPS_29_97: Final = FrameRate("29.97", 30, 30000 / 1001)
FPS_29_97_DROP: Final = FrameRate("29.97df", 30, 30000 / 1001, is_drop=True)
FPS_30: Final = FrameRate("30", 30, 30.0)
RATES: Final = {
    rate.name: rate for rate in (FPS_23_976, FPS_24, FPS_25, FPS_29_97, FPS_29_97_DROP, FPS_30)
}
CODED: Final = (FPS_24, FPS_25, FPS_29_97_DROP, FPS_30)
"""The rates that MIDI timecode and Art-Net can name, by their number there."""


class Timecode(NamedTuple):
    """The label of one frame."""

    hours: int
    minutes: int
    seconds: int
    frames: int

    def __str__(self) -> str:
        return f"{self.hours:02}:{self.minutes:02}:{self.seconds:02}:{self.frames:02}"

    def is_valid(self, rate: FrameRate) -> bool:
        """Return whether `rate` has a frame with this label."""
        is_in_range = (
            0 <= self.hours < HOURS
            and 0 <= self.minutes < 60
            and 0 <= self.seconds < 60
            and 0 <= self.frames < rate.labels
        )
        return is_in_range and not (
            rate.is_drop and self.frames < DROPPED and not self.seconds and self.minutes % 10
        )

    def frame(self, rate: FrameRate) -> int:
        """Return the number of the frame, from 0 at midnight."""
        minutes = 60 * self.hours + self.minutes
        dropped = DROPPED * (minutes - minutes // 10) if rate.is_drop else 0
        return (60 * minutes + self.seconds) * rate.labels + self.frames - dropped

    def at_s(self, rate: FrameRate) -> float:
        """Return when the frame begins, in seconds from midnight."""
        return self.frame(rate) / rate.frames_per_s


def timecode_of(frame: int, rate: FrameRate) -> Timecode:
    """Return the label of a frame; midnight follows the last one of a day."""
    frame %= rate.frames_per_day
    if rate.is_drop:
        minute = 60 * rate.labels - DROPPED
        tens, rest = divmod(frame, 10 * minute + DROPPED)
        frame += DROPPED * 9 * tens
        if rest >= minute + DROPPED:  # The first minute of ten drops none.
            frame += DROPPED * ((rest - DROPPED) // minute)
    rest, frames = divmod(frame, rate.labels)
    rest, seconds = divmod(rest, 60)
    hours, minutes = divmod(rest, 60)
    return Timecode(hours, minutes, seconds, frames)


class TimecodeStart(Struct, frozen=True):
    """The timecode at which a show begins: a label, or seconds from midnight.

    A label is seconds only at a rate, which may be known no sooner than with the first frame.
    """

    seconds: float = 0.0
    label: Timecode | None = None
    """Counts, if it is given."""

    def at_s(self, rate: FrameRate) -> float:
        """Return the start, in seconds from midnight."""
        return self.seconds if self.label is None else self.label.at_s(rate)

    def show_s(self, frames: float, rate: FrameRate) -> float:
        """Return the show time at so many frames from midnight; a show may pass midnight."""
        day = rate.frames_per_day
        frames -= self.at_s(rate) * rate.frames_per_s
        if abs(frames) > 0.5 * day:
            frames = (frames + 0.5 * day) % day - 0.5 * day
        return frames / rate.frames_per_s


_TIMECODE: Final = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})(?:[:;.](\d{1,2}))?")


def read_timecode(text: str) -> Timecode:
    """Return the timecode of `HH:MM:SS:FF` (or `HH:MM:SS`); raises `InputError`."""
    match = _TIMECODE.fullmatch(text.strip())
    parts = [int(part or 0) for part in match.groups()] if match else []
    if not parts or not Timecode(*parts).is_valid(FPS_30):
        raise InputError(f"{text!r} is no timecode; write HH:MM:SS:FF, as in 01:00:00:00")
    return Timecode(*parts)


def read_rate(text: str) -> FrameRate:
    """Return the rate of that name; raises `InputError`."""
    name = text.strip().lower()
    if name in ("29.97ndf", "23.98"):
        name = {"29.97ndf": "29.97", "23.98": "23.976"}[name]
    if name not in RATES:
        raise InputError(f"{text!r} is no frame rate: {known_names(name, RATES)}")
    return RATES[name]


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
    rate: FrameRate | None = None
    """None: as measured or labelled."""
    start: TimecodeStart = TimecodeStart()
    freewheel_s: float = 2.0
    song: str = ""
    """Of FPP: only what is played under this name is followed; empty: all."""

    @property
    def is_loopback(self) -> bool:
        """Whether packets of this computer only are taken."""
        return all(ipaddress.ip_network(text, strict=False).is_loopback for text in self.allowed)


class SendSpec(Struct, frozen=True, kw_only=True):
    """One receiver of timecode; `name` is a device, a port, or an address."""

    kind: SendKind
    name: str = ""
    port: int = 0
    rate: FrameRate = FPS_25
    offset_s: float = 0.0
    show: str = ""
    """Name of the show, for receivers that are told one."""


def is_song(wanted: str, played: str) -> bool:
    """Return whether what is played is the song wanted: by its name, without folder and ending."""
    path = PurePosixPath(played.replace("\\", "/").casefold())
    return wanted.casefold() in (str(path), path.name, path.stem)


def read_follow(
    text: str,
    *,
    rate: str | None = None,
    offset: str | float = 0.0,
    freewheel_s: float = 2.0,
    song: str = "",
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
    if song and kind != "fpp":
        raise InputError(f"{word} does not say which song is played; only fpp does")
    return FollowSpec(
        kind=kind,
        name="" if is_network else rest,
        allowed=_allowed(rest) if is_network and rest else (LOOPBACK,),
        rate=chosen,
        start=read_start(offset, chosen),
        freewheel_s=freewheel_s,
        song=song,
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
    port = {"artnet": ARTNET_PORT, "fpp": FPP_PORT}.get(kind, 0)
    if kind in ("artnet", "fpp", "osc"):
        rest, port = _address(text, rest, port)
    start = read_start(offset, chosen)
    return SendSpec(kind=kind, name=rest, port=port, rate=chosen, offset_s=start.at_s(chosen))


def read_start(value: str | float, rate: FrameRate | None = None) -> TimecodeStart:
    """Return the start that a number of seconds, or HH:MM:SS:FF, names; raises `InputError`."""
    if isinstance(value, str) and ":" in value:
        label = read_timecode(value)
        if rate is not None and not label.is_valid(rate):
            raise InputError(f"there is no frame {value} at {rate.name} frames a second")
        return TimecodeStart(label=label)
    try:
        seconds = float(value)
    except ValueError:
        seconds = math.nan
    if not abs(seconds) <= OFFSET_MAX_S:
        raise InputError(
            f"{value!r} is no start in timecode; write HH:MM:SS:FF, as in 01:00:00:00, or seconds"
        )
    return TimecodeStart(seconds)


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
