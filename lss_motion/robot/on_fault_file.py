"""The keys of `on_fault` in robot and sequence files.

Importing this module imports pydantic, so it is imported where a file is read.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, PlainValidator, ValidationInfo, WithJsonSchema

from lss_motion.robot.on_fault import Cause, FaultStep, Ladders, ladder_problem
from lss_motion.validation import FileModel


def _check_ladder(value: Any, info: ValidationInfo) -> tuple[FaultStep, ...]:  # noqa: ANN401  (YAML)
    words = value if isinstance(value, list) else [value]
    if problem := ladder_problem(str(info.field_name), words):
        raise ValueError(problem)
    return tuple(map(FaultStep, words))


_WORD = {"enum": [step.value for step in FaultStep]}
Ladder = Annotated[
    tuple[FaultStep, ...] | None,
    PlainValidator(_check_ladder),
    WithJsonSchema({"anyOf": [_WORD, {"type": "array", "items": _WORD, "minItems": 1}]}),
]


class JointOnFaultEntry(FileModel, title="on_fault of a joint"):
    """What is done when something is wrong with a joint: a step, or a ladder of steps.

    warn: say so; one that is silent or has restarted is sent no move until it is back and has its
    settings again (restarted: resume). slow: slow the show for all joints until this one has caught
    up. resume: brake, wait until it is back, go back to the place and go on. hold: brake and end
    the show. limp: let this joint go, and end the show. The next step is taken after patience_s.
    """

    astray: Ladder = Field(
        default=None, description="Further off its course than following_deg. [slow, hold]"
    )
    stuck: Ladder = Field(
        default=None, description="It cannot make the move at its present speed. [slow, hold]"
    )
    blocked: Ladder = Field(default=None, description="It cannot move at full power. [hold]")
    safe_mode: Ladder = Field(default=None, description="It protects itself. [hold]")
    error: Ladder = Field(default=None, description="It reports an error (LSS-PRO). [hold]")
    hot: Ladder = Field(default=None, description="Above temperature_max_c. [warn]")
    low_voltage: Ladder = Field(default=None, description="Below voltage_min_v. [warn]")
    restarted: Ladder = Field(
        default=None, description="It is limp, or has lost its settings. [resume, hold]"
    )
    silent: Ladder = Field(
        default=None, description="No answer for silent_s, though asked. [resume, hold]"
    )


class OnFaultEntry(JointOnFaultEntry, title="on_fault"):
    """As for a joint, for all of them; a joint's own wins over a show's, that over the robot's."""

    lost_port: Ladder = Field(default=None, description="A port is gone. [resume, hold]")


def ladders(entry: JointOnFaultEntry) -> Ladders:
    """Return the ladders that an entry gives, by cause."""
    return {Cause(key): value for key, value in entry if value is not None}
