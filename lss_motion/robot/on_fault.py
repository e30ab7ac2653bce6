"""Faults of a driven joint, and the steps that are taken on each: `on_fault`.

Each cause has an escalation, a list of steps. The next step is taken when the fault has lasted
`patience_s` on the one before. Where several are given, that of the joint is used, else of the
show, else of the robot, else of `DEFAULTS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeAlias

from lss_motion.files.texts import known_names

if TYPE_CHECKING:
    from collections.abc import Sequence


class Cause(StrEnum):
    """A kind of fault."""

    ASTRAY = "astray"
    STUCK = "stuck"
    BLOCKED = "blocked"
    SAFE_MODE = "safe_mode"
    ERROR = "error"
    HOT = "hot"
    LOW_VOLTAGE = "low_voltage"
    RESTARTED = "restarted"
    SILENT = "silent"
    LOST_TURN = "lost_turn"
    """It is in another turn than it was; a move would take it through the turns between."""
    LOST_PORT = "lost_port"
    STALLED = "stalled"
    """This program was held up: no cause of a joint."""
    SOUND = "sound"
    """A sound of the show cannot be played: no cause of a joint."""


class FaultStep(StrEnum):
    """A step that is taken on a fault."""

    WARN = "warn"
    """Show a warning."""
    SLOW = "slow"
    """Slow the show clock for all joints until this one has caught up."""
    RESUME = "resume"
    """Brake all joints, wait until it replies, set it up again, return to the pose, continue."""
    HOLD = "hold"
    """Brake all joints within the limits and end the show; the servos hold."""
    LIMP = "limp"
    """Switch this joint limp at once; `hold` for the others."""


Escalations: TypeAlias = Mapping[Cause, tuple[FaultStep, ...]]

ENDING: Final = frozenset({FaultStep.HOLD, FaultStep.LIMP})
"""Steps that end the show, so no step can follow."""

RESUMABLE: Final = frozenset({Cause.SILENT, Cause.RESTARTED, Cause.LOST_PORT, Cause.STALLED})
"""Causes that can pass without a repair; only these allow `resume`."""

DEFAULTS: Final[Escalations] = MappingProxyType(
    {
        Cause.ASTRAY: (FaultStep.SLOW, FaultStep.HOLD),
        # Status 8 (FACTS.md S2): the motor cannot make the move at its present speed.
        Cause.STUCK: (FaultStep.SLOW, FaultStep.HOLD),
        Cause.BLOCKED: (FaultStep.HOLD,),
        Cause.SAFE_MODE: (FaultStep.HOLD,),
        Cause.ERROR: (FaultStep.HOLD,),
        # The servo protects itself at a temperature ten degrees higher.
        Cause.HOT: (FaultStep.WARN,),
        Cause.LOW_VOLTAGE: (FaultStep.WARN,),
        Cause.RESTARTED: (FaultStep.RESUME, FaultStep.HOLD),
        Cause.SILENT: (FaultStep.RESUME, FaultStep.HOLD),
        Cause.LOST_TURN: (FaultStep.HOLD,),
        Cause.LOST_PORT: (FaultStep.RESUME, FaultStep.HOLD),
        Cause.STALLED: (FaultStep.RESUME, FaultStep.HOLD),
        Cause.SOUND: (FaultStep.WARN,),
    }
)


ONLY: Final[Mapping[Cause, tuple[frozenset[FaultStep], str]]] = MappingProxyType(
    {
        Cause.LOST_PORT: (
            frozenset({FaultStep.RESUME, FaultStep.HOLD}),
            "a lost port takes no command, so there is no {}; use resume or hold",
        ),
        Cause.STALLED: (
            frozenset({FaultStep.RESUME, FaultStep.HOLD}),
            "after a stall the robot is not where the show is, so there is no {}; use resume or "
            "hold",
        ),
        Cause.SOUND: (
            frozenset({FaultStep.WARN, FaultStep.HOLD}),
            "a sound that cannot be played does not come back, so there is no {}; use warn or hold",
        ),
        Cause.LOST_TURN: (
            ENDING,
            "a joint in another turn cannot be driven, so there is no {}; use hold or limp",
        ),
    }
)
"""The steps that can be taken on these causes, and the text for any other."""


def escalation_problem(cause: str, steps: Sequence[object]) -> str:
    """Return why `steps` are not an escalation for `cause`; an empty text if they are."""
    if not steps:
        return f"names no step; {known_names('', map(str, FaultStep))}"
    for place, step in enumerate(steps):
        if step not in list(FaultStep):
            return f"step {str(step)!r} is not known; {known_names(str(step), map(str, FaultStep))}"
        if step == FaultStep.RESUME and cause not in RESUMABLE:
            return f"nothing comes back from {cause}; resume is for {', '.join(sorted(RESUMABLE))}"
        if cause in ONLY and step not in ONLY[Cause(cause)][0]:
            return ONLY[Cause(cause)][1].format(step)
        if step in ENDING and place + 1 < len(steps):
            return f"nothing comes after {step}, which ends the show"
        if step in steps[:place]:
            return f"{step} stands there twice"
    return ""


def escalations_text(escalations: Escalations) -> str:
    """Return escalations in one line, such as `astray=warn silent=resume,hold`."""
    return " ".join(f"{cause}={','.join(steps)}" for cause, steps in escalations.items())


def escalations_from(text: str) -> Escalations:
    """Return the escalations of `escalations_text`; raises `ValueError` for other text."""
    escalations = {}
    for item in text.split():
        cause, _, words = item.partition("=")
        steps = words.split(",")
        if cause not in list(Cause):
            raise ValueError(f"cause {cause!r} is not known; {known_names(cause, map(str, Cause))}")
        if problem := escalation_problem(cause, steps):
            raise ValueError(problem)
        escalations[Cause(cause)] = tuple(map(FaultStep, steps))
    return escalations
