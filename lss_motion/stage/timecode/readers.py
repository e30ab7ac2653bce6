"""From bytes and sound of one way of transport to observations for the chase; pure.

Each reader chooses the frame rate, unless it is given: that of the label, or of LTC the measured
one, where the rate is not coded. Positions are seconds from the start of the show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.stage.timecode import packets
from lss_motion.stage.timecode.chase import FPP, Observation
from lss_motion.stage.timecode.ltc import LtcDecoder
from lss_motion.stage.timecode.mtc import MtcDecoder
from lss_motion.stage.timecode.timecode import (
    FPS_24,
    FPS_25,
    FPS_29_97,
    FPS_29_97_DROP,
    FPS_30,
    Start,
)
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.stage.timecode.ltc import LtcFrame
    from lss_motion.stage.timecode.timecode import Rate

    Say = Callable[[str], None]

NEAR_RATIO: Final = 0.08
"""A measured rate that is nearer to one of the known ones is taken for it. 24 and 25 are 4 % apart,
so the nearest counts; beyond, the tape is wound."""
FROM_MIDNIGHT: Final = Start()
PLAYERS_MAX: Final = 256
SETTLED: Final = 4
"""So many frames in a row must be of another rate before the rate is changed."""


def of_label(coded: Rate, wanted: Rate | None, say: Say, way: str) -> Rate | None:
    """Return the rate by which a label is read; None: it is not that of the timecode wanted."""
    if wanted is None or wanted == coded:
        return coded
    if wanted.labels != coded.labels:
        say(
            f"{way} comes with {coded.labels} frames a second, but {wanted.name} are asked for: "
            f"it is not followed. Change one of them"
        )
        return None
    if wanted.is_drop != coded.is_drop:
        has = "drop-frame" if coded.is_drop else "no drop-frame"
        say(f"{way} has {has}, other than the {wanted.name} asked for: read as it is")
        return FPS_29_97_DROP if coded.is_drop else (FPS_29_97 if wanted.is_drop else wanted)
    return wanted


class LtcReader:
    """Observations from sound. `instant_ns` of a sample is given with each block."""

    def __init__(
        self, rate_hz: int, wanted: Rate | None, say: Say, start: Start = FROM_MIDNIGHT
    ) -> None:
        self.decoder = LtcDecoder(rate_hz)
        self.frames = 0
        self._rate_hz, self._wanted, self._say = rate_hz, wanted, say
        self._start = start
        self._rate: Rate | None = None
        self._other = 0

    def take(
        self, block: NDArray[np.float32], instant_of: Callable[[float], float]
    ) -> Iterator[Observation]:
        """Yield what is known with these samples; `instant_of` turns samples into ns."""
        for frame in self.decoder.take(block):
            self.frames += 1
            rate = self._rate_of(frame)
            if rate is None or not frame.timecode.is_valid(rate):
                continue
            number = frame.timecode.frame(rate) + (0 if frame.is_reverse else 1)
            direction = -1 if frame.is_reverse else 1
            instant_ns = round(instant_of(frame.at))
            yield Observation(instant_ns, self._start.show_s(number, rate), direction)

    def _rate_of(self, frame: LtcFrame) -> Rate | None:
        measured = self._rate_hz / frame.frame_samples
        near = min((FPS_24, FPS_25, FPS_30), key=lambda r: abs(r.frames_per_s - measured))
        if abs(measured / near.frames_per_s - 1.0) > NEAR_RATIO:
            return self._rate  # It is wound, or two frames in one: judged by the chase.
        if frame.is_drop and near.labels == FPS_30.labels:
            near = FPS_29_97_DROP
        if self._rate is None or near.labels != self._rate.labels:
            self._other += 1
            if self._rate is not None and self._other < SETTLED:
                return self._rate
        self._other = 0
        self._rate = near
        return of_label(near, self._wanted, self._say, "LTC")


class MtcReader:
    """Observations from MIDI messages."""

    def __init__(self, wanted: Rate | None, say: Say, start: Start = FROM_MIDNIGHT) -> None:
        self._decoder = MtcDecoder()
        self._wanted, self._say, self._start = wanted, say, start

    def take(self, message: bytes, instant_ns: int) -> Iterator[Observation]:
        """Yield what is known with this message."""
        for reading in self._decoder.take(message, instant_ns):
            rate = of_label(reading.rate, self._wanted, self._say, "MIDI timecode")
            if rate is None or not reading.timecode.is_valid(rate):
                continue
            frames = reading.timecode.frame(rate) + reading.past_frames
            position_s = self._start.show_s(frames, rate)
            yield Observation(reading.instant_ns, position_s, reading.direction)


class ArtNetReader:
    """Observations from UDP packets, each with the name of its source."""

    def __init__(self, wanted: Rate | None, say: Say, start: Start = FROM_MIDNIGHT) -> None:
        self._wanted, self._say, self._start = wanted, say, start

    def take(
        self, packet: bytes, address: str, instant_ns: int
    ) -> Iterator[tuple[Observation, str]]:
        """Yield what is known with this packet."""
        reading = packets.read_artnet(packet)
        if reading is None:
            return
        rate = of_label(reading.rate, self._wanted, self._say, "Art-Net timecode")
        if rate is None or not reading.timecode.is_valid(rate):
            return
        source = f"{address} stream {reading.stream}" if reading.stream else address
        position_s = self._start.show_s(reading.timecode.frame(rate), rate)
        yield Observation(instant_ns, position_s), source


class FppReader:
    """Observations from UDP packets of Falcon Players, each with the address of its player.

    What a player plays does not tell it apart from another. Its sequence counts while one plays,
    or else its media.
    """

    def __init__(self, start: Start = FROM_MIDNIGHT) -> None:
        self._start = start
        self._items: dict[str, tuple[str, str, int]] = {}
        """What each player plays: kind, name, and when it was heard of last."""

    def take(
        self, packet: bytes, address: str, instant_ns: int
    ) -> Iterator[tuple[Observation, str]]:
        """Yield what is known with this packet."""
        reading = packets.read_fpp(packet)
        if reading is None or reading.action == "open":
            return
        is_stop = reading.action == "stop"
        kind, name, heard_ns = self._items.get(address, ("", "", 0))
        if kind and instant_ns - heard_ns <= ns_from_s(FPP.gap_s):
            is_beside = kind == "sequence" and reading.kind != kind
            if is_beside or (is_stop and (kind, name) != (reading.kind, reading.name)):
                return
        if is_stop:
            self._items.pop(address, None)
        else:
            if len(self._items) >= PLAYERS_MAX:  # Addresses are easily forged.
                self._items.clear()
            self._items[address] = (reading.kind, reading.name, instant_ns)
        position_s = self._start.show_s(reading.seconds * FPS_25.frames_per_s, FPS_25)
        yield Observation(instant_ns, position_s, 0 if is_stop else 1), address
