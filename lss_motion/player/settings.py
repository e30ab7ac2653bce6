"""The settings of a show: what each servo gets for its drive, and gets back afterwards.

For the time of the show, every timed servo gets the joint's own limits (AA, AD and SD), so that it
keeps them whatever it hears, and EM1, in which `D…T…` works; a streamed one gets EM0 with the
program's FPC; afterwards each gets back what it had. An RC servo on a 2IO has no settings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.player.agenda import LIT_KEYWORD
from lss_motion.player.dialogue import Item
from lss_motion.program.model import ramp_setting_deg_s2
from lss_motion.protocol.codec import make_command, read_reply
from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.line import Command, Reply

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping

    from lss_motion.robot.model import Joint

    Answers = Mapping[tuple[str, int, str], int | str | None]

RESTORING_TIMES: Final = 2
"""Settings are given back so often, unasked: a stop must not take longer than this."""
SESSION_KEYWORDS: Final = ("EM", "AA", "AD", "SD", "FPC", "IPE")
LIMIT_KEYWORDS: Final = ("EM", "AA", "AD", "SD")
"""Without these a servo does not keep the joint's limits, or takes no limits at all."""


def stored(joint: Joint, answers: Answers, keyword: str) -> float | None:
    """Return the number that a servo answered to `keyword`, in physical units, if it did."""
    value = answers.get((joint.bus, joint.servo_id, keyword))
    if not isinstance(value, int):
        return None
    said = read_reply(joint.model.family, Reply(joint.servo_id, keyword, value))
    return float(said.value) if said is not None and isinstance(said.value, int | float) else None


def session_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the settings for the show that servos said what they had of; for others `unsure`."""
    orders = []
    for joint in joints:
        orders += _session_orders(joint, answers, is_known=True)
        orders += [
            _order(joint, Command(joint.servo_id, keyword, value))
            for keyword, value in joint.settings.items()
        ]
    return orders


def unsure_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the limits for the show that servos did not say what they had of.

    The line was bad, or the servo does not know them (no document says which family answers all):
    it is told them all the same, for limits hold. What it had nobody knows: it keeps them until
    it restarts.
    """
    return [
        order
        for joint in joints
        for order in _session_orders(joint, answers, is_known=False)
        if order.command.keyword in LIMIT_KEYWORDS
    ]


def _session_orders(joint: Joint, answers: Answers, *, is_known: bool) -> list[Item]:
    known = FAMILY_TABLES[joint.model.family].by_keyword
    return [
        _order(joint, make_command(joint.model.family, joint.servo_id, keyword, value))
        for keyword, value in _session_of(joint).items()
        if f"Q{keyword}" in known
        and is_known is (stored(joint, answers, f"Q{keyword}") is not None)
    ]


def changed(joint: Joint, lit: Container[str]) -> list[str]:
    """Return what a show that changes the colours of the joints `lit` sets besides the drive."""
    lights = [LIT_KEYWORD] if joint.name in lit and LIT_KEYWORD not in joint.settings else []
    return [*joint.settings, *lights]


def _session_of(joint: Joint) -> dict[str, float]:
    """Return the session settings that the drive of a joint needs, in physical units.

    FPC comes before EM0, so that the filter is what it should be from its first step on. Whether
    SD bounds anything in EM0 is not known; it does no harm.
    """
    if joint.drive == "stepped":
        return {}
    if joint.drive == "streamed":
        count = float(joint.filter_count)
        return {"FPC": count, "IPE": 1.0, "SD": joint.speed_max_deg_s, "EM": 0.0}
    ramp = float(ramp_setting_deg_s2(joint))
    return {"EM": 1.0, "AA": ramp, "AD": ramp, "SD": joint.speed_max_deg_s}


def restoring_orders(
    joints: Iterable[Joint], answers: Answers, lit: Container[str] = ()
) -> list[Item]:
    """Return what gives every servo back its settings, and to those `lit` their colours.

    All of it is said `RESTORING_TIMES`.
    """
    return [
        _order(joint, Command(joint.servo_id, keyword, had))
        for _ in range(RESTORING_TIMES)
        for joint in joints
        for keyword in (*SESSION_KEYWORDS, *changed(joint, lit))
        if isinstance(had := answers.get((joint.bus, joint.servo_id, f"Q{keyword}")), int)
    ]


def _order(joint: Joint, command: Command) -> Item:
    return Item(bus=joint.bus, command=command, is_question=False)
