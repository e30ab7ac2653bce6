"""What the process that plays the sounds of a show is told, and what it reports.

The player (`playing.sounds`) sends a `SoundOrder`, the process (`sound.device`) a `SoundNews`.
"""

from __future__ import annotations

from msgspec import Struct

from lss_motion.system.clock_leg import ClockLeg  # noqa: TC001  (msgspec reads the type)


class SetLeg(Struct, frozen=True, tag=True):
    """The show clock, from now on."""

    leg: ClockLeg


class PlaySound(Struct, frozen=True, tag=True):
    """A sound of the show; the values are those of `Voice`."""

    number: int
    path: str
    at_s: float
    gain_ratio: float
    is_bed: bool
    is_looped: bool
    duck_ratio: float
    speed_ratio: float
    until_s: float


class SetOffset(Struct, frozen=True, tag=True):
    """All sounds later by so much."""

    offset_s: float


class ClearSounds(Struct, frozen=True, tag=True):
    """Forget all sounds."""


class SetLeads(Struct, frozen=True, tag=True):
    """Whether the show follows what is heard of the bed."""

    leads: bool


class StillPlaying(Struct, frozen=True, tag=True):
    """The show still runs."""


class EndSounds(Struct, frozen=True, tag=True):
    """Fade out, and end."""


SoundOrder = SetLeg | PlaySound | SetOffset | ClearSounds | SetLeads | StillPlaying | EndSounds


class DeviceOpened(Struct, frozen=True, tag=True):
    """Sounds can be played."""

    name: str
    driver: str
    latency_s: float


class NoDevice(Struct, frozen=True, tag=True):
    """Nothing can be played."""

    text: str


class SoundBegun(Struct, frozen=True, tag=True):
    """A sound has begun."""

    number: int


class SoundFailed(Struct, frozen=True, tag=True):
    """A sound cannot be played; 0 is none by its number."""

    number: int
    text: str


class Heard(Struct, frozen=True, tag=True):
    """What is heard of the bed."""

    instant_ns: int
    show_s: float
    rate: float


class WrongRate(Struct, frozen=True, tag=True):
    """This device has no clock to follow."""

    ratio: float


class DeviceLost(Struct, frozen=True, tag=True):
    """The device is gone."""

    text: str


class Dropouts(Struct, frozen=True, tag=True):
    """How often the device was not given its frames in time; at the end."""

    count: int


SoundNews = (
    DeviceOpened | NoDevice | SoundBegun | SoundFailed | Heard | WrongRate | DeviceLost | Dropouts
)
