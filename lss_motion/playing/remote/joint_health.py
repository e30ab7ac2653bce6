"""What servos reported, as that of the joints that they move."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.protocol.constants import Status

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.playing.joint_view import JointView
    from lss_motion.playing.remote.schema import JointHealth
    from lss_motion.robot.mechanism import Mechanism


_AT_WORK: Final = (
    *(Status.UNKNOWN, Status.HOLDING, Status.ACCELERATING, Status.TRAVELING, Status.DECELERATING),
    *(Status.FREE_MOVING, Status.LIMP),
)
_SEVERITY: Final = [s.value for s in (*_AT_WORK, *(s for s in Status if s not in _AT_WORK))]
"""What servos report, the worst last."""


def _worst(own: Sequence[JointHealth], allowed_deg: float) -> JointHealth:
    """Return what the servos of a mechanism reported, as of one servo."""
    statuses = [one.status for one in own if one.status is not None]
    return replace(
        own[0],
        status=max(statuses, key=_SEVERITY.index, default=None),
        temperature_c=max(
            (o.temperature_c for o in own if o.temperature_c is not None), default=None
        ),
        voltage_v=min((o.voltage_v for o in own if o.voltage_v is not None), default=None),
        current_a=max((o.current_a for o in own if o.current_a is not None), default=None),
        error_deg=None,
        correction_deg=0.0,
        allowed_deg=allowed_deg,
    )


def _mapped(
    health: JointHealth,
    own: Sequence[JointHealth],
    here: np.ndarray,
    mechanism: Mechanism,
    joint: str,
) -> JointHealth:
    """Return it with error and correction in degrees of the joint; the servos stand `here`."""
    g, column = mechanism.transmission, mechanism.joints.index(joint)
    errors = [one.error_deg for one in own]
    is_read = None not in errors
    off = np.array([[0.0 if error is None else error for error in errors]])
    added = np.array([[one.correction_deg for one in own]])
    at, read, aimed = g.joint_deg(np.concatenate([here, here - off, here + added]))[:, column]
    return replace(
        health,
        error_deg=round(float(at - read), 3) if is_read else None,
        correction_deg=round(float(aimed - at), 3),
    )


def joints_health(
    view: JointView,
    servos: Mapping[str, JointHealth],
    predicted_deg: Mapping[str, float],
) -> dict[str, JointHealth]:
    """Return what servos reported as that of their joints: of several servos the worst.

    `predicted_deg` is where the servos are, where that is needed to map their errors.
    """
    if view.is_plain:
        return dict(servos)
    found: dict[str, JointHealth] = {}
    for joint in view.robot.joints:
        own = [servos[name] for name in view.servos_of(joint) if name in servos]
        if not own:
            continue
        mechanism = view.mechanism_of(joint)
        if mechanism is None or len(own) < len(mechanism.servos):
            found[joint] = own[0]
            continue
        found[joint] = _worst(own, view.robot.joints[joint].following_deg)
        if {*mechanism.servos} <= predicted_deg.keys():
            here = np.array([[predicted_deg[name] for name in mechanism.servos]])
            found[joint] = _mapped(found[joint], own, here, mechanism, joint)
    return found
