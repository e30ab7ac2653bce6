"""Every physical number of a simulated servo, with its source or marked as assumed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import ServoModel
    from lss_motion.sim.hand import HandGuide, Push

TICK_NS = 5_000_000
"""One control loop of a servo: 5 ms (FACTS.md M7)."""

FILTER_TICKS = 4
"""The EM0 filter steps every 20 ms, four control loops (FACTS.md M6)."""


class Turnaround(Struct, frozen=True, kw_only=True):
    """Instants between the last byte of a query and the first byte of its reply.

    `single_min_ns` … `single_max_ns`: uniform, for one query. The other three belong to the
    ordered forms of firmware 370.
    """

    single_min_ns: int
    single_max_ns: int
    group_ns: int = 3_000_000
    """Before the first reply to a group line: 3 ms measured at 921600 (FACTS.md W15)."""
    group_gap_ns: int = 150_000
    """Between two servos of a group: 0.5 ms each, less its bytes (FACTS.md W15)."""
    broadcast_ns: int = 200_000
    """Before slot 0 of an ordered broadcast: 200 µs + id times slot (FACTS.md W16)."""
    slot_gap_ns: int = 150_000
    slot_reply_bytes: int = 12
    """Width of a SLOT: a gap, and the line time of so many bytes for each query. Assumed; it
    depends on line rate and reply length (FACTS.md W19), and only the slot of QID is given in its
    command."""


Lines = Literal["strict", "lenient"]


class Physics(Struct, frozen=True, kw_only=True):
    """The numbers that every servo of a bus shares. An *assumed* default has no published source.

    `lag_s`                 first-order lag of the horn behind the servo's own profile. Assumed.
    `lag_per_stiffness_ratio`  one step of AS divides the lag by this. Assumed; the documents say
                            only that a stiffer servo keeps closer to the position asked for.
    `ramp_per_stiffness_ratio`  one step of AS makes the ramps so many times AA and AD. FACTS.md
                            M24; the amount is assumed.
    `droop_per_stiffness_ratio`  one step of AH divides the droop under load by this. Assumed.
    `ramp_ratio`            real ramps are this many times the values of AA and AD. Their step of
                            10 deg/s² has weak sources (FACTS.md M20).
    `retarget`, `t_law`     FACTS.md A10, A11: what a `D…T…` in mid-move starts from, what T times.
    `dead_s`                a command takes effect so much later. Assumed: at the next control loop.
    `t_ignored_s`, `t_least_s`, `t_step_s`  a shorter T is ignored, or is taken as this one; T is
                            rounded to multiples of the step. Assumed: nothing of this; no document
                            gives a smallest T.
    `lines`                 what servos do with lines that no document describes: `strict`, they
                            ignore them, or `lenient` (FACTS.md A27). Assumed: strict.
    `noise_deg`             half width of the uniform noise of a position reading of an LSS
                            (FACTS.md E7: one tenth).
    `pro_noise_ratio`       noise of an LSS-PRO over that (FACTS.md P15: a few hundredths).
    `supply_v`              battery without load: 12 V is nominal (FACTS.md E4).
    `supply_ohm`            resistance of battery and wiring. Assumed.
    `supply_min_v` … `supply_max_v`  the range of the datasheets, 6 to 12.6 V (FACTS.md E4); safe
                            mode outside it. That the servos trip just there is assumed.
    `nominal_v`             voltage at which a model's top speed holds; speed is proportional to
                            voltage, as for any brushed motor. 12 V: FACTS.md E4, E8.
    `idle_ma`               current of the electronics: 70 mA (FACTS.md E6).
    `running_ma`            more current at top speed without load. Assumed.
    `load_ma_per_deg`       more current for each degree of droop that is held up. Assumed.
    `stall_ma`              current of a motor that pushes and cannot turn. Assumed.
    `ambient_c`             temperature of the room and of a servo at power-up. Assumed.
    `heating_c_per_a2`      steady rise of temperature per squared ampere of motor current. Assumed
                            so that 1.5 A, which users plan for (FACTS.md E5), can be sustained.
    `heating_s`             time constant of that rise. Assumed.
    `temperature_max_c`     safe mode above it: 85 C (FACTS.md S7).
    `stall_deg`             a horn this far behind and not turning is stuck. Assumed.
    `blocked_s`, `safe_s`   how long stuck until blocked (9), until safe mode (10). Assumed.
    `hand_give_ratio`       share of the way to the hand that a powered horn yields, at the default
                            holding stiffness. Assumed.
    `torque_per_step_mode_ratio`  each halving of an LSS-PRO's steps (SM) leaves so much of its
                            torque, and half of its top speed. Assumed; FACTS.md P8 says only that
                            both change.
    `rc_limp_s`             in RC mode a servo goes limp so long after its last pulse, or after its
                            first position (FACTS.md R14).
    `rc_escape_s`           RC mode ends after so long a high level, as on a silent line (R14).
    `usb_back_s`            how long the port is gone while the LSS-PRO behind it restarts. Assumed;
                            the maker's example waits 10 s (FACTS.md P12).
    `corrupt_reply_ratio`   share of replies that the firmware itself damages; None: that of the
                            bus's firmware, `corrupt_reply_ratio_of`.
    """

    lag_s: float = 0.02
    lag_per_stiffness_ratio: float = 1.1
    ramp_per_stiffness_ratio: float = 1.1
    droop_per_stiffness_ratio: float = 1.1
    ramp_ratio: float = 1.0
    retarget: Literal["keep_speed", "from_rest"] = "keep_speed"
    t_law: Literal["cruise", "exact"] = "cruise"
    dead_s: float = 0.0
    t_ignored_s: float = 0.0
    t_least_s: float = 0.0
    t_step_s: float = 0.0
    lines: Lines = "strict"
    noise_deg: float = 0.1
    pro_noise_ratio: float = 0.2
    supply_v: float = 12.0
    supply_ohm: float = 0.05
    supply_min_v: float = 6.0
    supply_max_v: float = 12.6
    nominal_v: float = 12.0
    idle_ma: float = 70.0
    running_ma: float = 130.0
    load_ma_per_deg: float = 200.0
    stall_ma: float = 1500.0
    ambient_c: float = 25.0
    heating_c_per_a2: float = 15.0
    heating_s: float = 300.0
    temperature_max_c: float = 85.0
    stall_deg: float = 5.0
    blocked_s: float = 0.5
    safe_s: float = 2.0
    hand_give_ratio: float = 0.05
    torque_per_step_mode_ratio: float = 0.8
    rc_limp_s: float = 2.0
    rc_escape_s: float = 30.0
    usb_back_s: float = 4.0
    corrupt_reply_ratio: float | None = None
    turnaround: Turnaround | None = None
    """None: that of the bus's firmware, `turnaround_of`."""

    def __post_init__(self) -> None:
        if self.lag_s <= 0.0:
            raise ValueError(f"lag_s is {self.lag_s}; a horn needs a lag above 0")


class ServoSpec(Struct, frozen=True, kw_only=True):
    """One servo on the bus when the power comes on.

    `start_deg`   raw angle of the horn at power-up, within ±180 (FACTS.md R5: turns are lost): from
                  the factory's zero, clockwise, whatever `eeprom` has for G and O
    `droop_deg`   how far the load pulls the horn below a held position when its arm is level;
                  the pull goes with the cosine of the angle from `level_deg` and is towards
                  negative angles. 0: no load
    `backlash_deg`  play between the gears and the horn, from end to end. The position sensor is
                  taken to sit on the horn's side of it
    `eeprom`      configured values that differ from the factory's, by keyword (`{"G": -1}`)
    `answers`     replies to queries that are not simulated, by row name and in wire units:
                  `{"N": "12345678", "IX": 30}`
    `baud_bps`, `firmware`  None: that of the bus
    `hand`        the motion of a hand that moves the horn; None: no hand
    `push`        a push that displaces the horn for a while; None: there is none

    With a model of the 2IO family it is one RC servo of a board (`boards`), which uses only G of
    `eeprom`, and no `answers`.
    """

    servo_id: int
    model: ServoModel
    start_deg: float = 0.0
    droop_deg: float = 0.0
    level_deg: float = 0.0
    backlash_deg: float = 0.0
    eeprom: Mapping[str, int] = field(default_factory=dict)
    answers: Mapping[str, int | str] = field(default_factory=dict)
    baud_bps: int | None = None
    firmware: int | None = None
    hand: HandGuide | None = None
    push: Push | None = None


FAST_REPLY_FIRMWARE = 369
"""From here on queries are answered faster (FACTS.md V5)."""


CORRUPT_REPLY_RATIO = 0.001
"""Share of replies that a firmware up to 368 damages. Assumed; FACTS.md W21."""

CORRUPT_SERIAL_RATIO = 10.0
"""Factor for replies to QN, where the damage was "most prevalent". Assumed."""


def corrupt_reply_ratio_of(firmware: int) -> float:
    """Default of a firmware: a race up to 368 damages replies on a free line (FACTS.md W21)."""
    return 0.0 if firmware >= FAST_REPLY_FIRMWARE else CORRUPT_REPLY_RATIO


def turnaround_of(firmware: int) -> Turnaround:
    """Default of a firmware: 0.2-1.0 ms, older ones 1.0-1.8 ms (FACTS.md W14; not measured)."""
    if firmware >= FAST_REPLY_FIRMWARE:
        return Turnaround(single_min_ns=200_000, single_max_ns=1_000_000)
    return Turnaround(single_min_ns=1_000_000, single_max_ns=1_800_000)
