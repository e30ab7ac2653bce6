"""What stands between joints and servos: gears, linkages, differentials, pairs.

The law: `servo_deg = zero_deg + direction * g(joint_deg)`. A transmission is g and its derivatives,
in degrees of an ideal servo, which has zero 0 and direction 1, and its inverse. A `Mechanism` has
one, with the names of its joints and of its servos. `robot.transmission` has the kinds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from msgspec import Struct

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

MechanismKind = Literal["ratio", "linkage", "differential", "pair", "table"]


class Transmission(Protocol):
    """g of a mechanism with J joints and S servos, at n places at once."""

    @property
    def is_constant(self) -> bool:
        """Whether the slopes are the same everywhere."""
        ...

    def servo_deg(self, joint_deg: FloatArray) -> FloatArray:
        """Return the angles of ideal servos, (n, S), of joint angles, (n, J)."""
        ...

    def slopes(self, joint_deg: FloatArray) -> FloatArray:
        """Return the derivative of each servo with respect to each joint, (n, S, J)."""
        ...

    def bends(self, joint_deg: FloatArray, first: FloatArray) -> FloatArray:
        """Return the second derivative of each servo, (n, S), along joint speeds `first`, (n, J).

        It is what the speed of the joints adds to the acceleration of the servos.
        """
        ...

    def joint_deg(self, servo_deg: FloatArray) -> FloatArray:
        """Return the joint angles, (n, J), that fit the angles of ideal servos best, (n, S)."""
        ...


class Mechanism(Struct, frozen=True, kw_only=True):
    """Joints and the servos that move them. A gear or a linkage of a joint has the joint's name."""

    name: str
    kind: MechanismKind
    joints: tuple[str, ...]
    servos: tuple[str, ...]
    """Names of `Robot.servos`: `neck.left`, or that of the joint where it has one servo."""
    transmission: Transmission
    moved_deg: tuple[tuple[float, float, float], ...] = ()
    """By `smooth_deg`: joint angle, measured and used servo angle of each point."""

    def derivatives(self, joint_deg: FloatArray, *path: FloatArray) -> list[FloatArray]:
        """Return as many derivatives of the servos, (n, S) each, as `path` has of the joints.

        One or two, (n, J) each: g'q', and g'q'' with what g' itself changes by.
        """
        import numpy as np

        slopes = self.transmission.slopes(joint_deg)
        found = [np.asarray(np.einsum("nsj,nj->ns", slopes, one)) for one in path]
        if len(found) > 1:
            found[1] = self.transmission.bends(joint_deg, path[0]) + found[1]
        return found

    @property
    def is_scaled(self) -> bool:
        """One joint with fixed ratios: its limits are those of its servos, divided by them."""
        return self.transmission.is_constant and len(self.joints) == 1

    @property
    def is_redundant(self) -> bool:
        """More servos than joints: they can work against each other."""
        return len(self.servos) > len(self.joints)

    def fight_deg(self, servo_deg: FloatArray) -> FloatArray:
        """Return by how much ideal servos, (n, S), are apart from what their joints allow, (n,)."""
        fitting = self.transmission.servo_deg(self.transmission.joint_deg(servo_deg))
        off = servo_deg - fitting
        fight: FloatArray = off.max(axis=1) - off.min(axis=1)
        return fight

    def servo_label(self, servo: str) -> str:
        """Return the servo as a person calls it: `left servo of neck`."""
        short = servo.removeprefix(f"{self.name}.")
        return f"servo of {self.name}" if short == servo else f"{short} servo of {self.name}"
