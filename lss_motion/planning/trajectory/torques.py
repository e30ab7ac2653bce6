"""What a plan asks of the servos of a robot with masses: torque, current, heat, give.

The torque of each servo (`robot.dynamics`) is held against what the servo has at that speed and
voltage. A direct current motor gives its largest torque when it stands, none at its top speed, and
both fall with the voltage; where the load drives it, it holds back with all it has. What no file
says is a field of `ServoAssumptions`, and is printed with the result.
"""

from __future__ import annotations

import bisect
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.robot.dynamics import RigidTree
from lss_motion.robot.servo_models import SERVO_MODELS, STATIC_TORQUE_N_M
from lss_motion.show.gait.kinematics import figure_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.figure import Figure
    from lss_motion.robot.model import Joint, Robot, ServoModel

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.01
"""Instants at which a plan is judged. Chosen: a tenth of an ordinary ramp, in which speed and
acceleration, and so the torque, change little."""
BLOCK: Final = 8192
"""Instants at once, so that a long show needs no more memory than a short one."""
NOMINAL_V: Final = 12.0
"""The voltage at which top speed and torque of a model hold (FACTS.md E1, E4)."""
STALL_MODEL: Final = "LSS-ST1"
"""The model that `ServoAssumptions.stall_a` is about."""
LEAST_RATIO: Final = 0.01
"""Torques below this share of what a servo holds are never too much: at its top speed it has none,
and friction, which is larger, is not known either."""
HEAT_STEP_S: Final = 1.0
"""Step in which temperatures are kept: they change within minutes."""
PASSES_MAX: Final = 1_000_000
"""More than the shortest pass needs until its heat is steady."""
GIVES_WAY_MIN_DEG: Final = 0.2
"""Chosen: twice the unit of a servo; less is not printed."""


class ServoAssumptions(Struct, frozen=True, kw_only=True):
    """What is assumed of servos. No document gives it (FACTS.md E5, E6, E10).

    `stall_a`       current of an LSS-ST1 that gives all its torque; that of other models goes with
                    their power, torque times top speed. Current goes with torque at any voltage
    `no_load_a`     more current at top speed
    `idle_a`        current of the electronics
    `give_deg`      how far a horn gives way under all the torque of its servo
    `ambient_c`     temperature of a servo when the show begins
    `heating_c_per_a2`, `heating_s`  steady rise of temperature per squared ampere of the motor, and
                    its time constant
    """

    stall_a: float = 1.5
    no_load_a: float = 0.13
    idle_a: float = 0.07
    give_deg: float = 5.0
    ambient_c: float = 25.0
    heating_c_per_a2: float = 15.0
    heating_s: float = 300.0


class ServoLoad(Struct, frozen=True, kw_only=True):
    """What a plan asks of one servo. A ratio is None for a model whose torque is not known."""

    servo: str
    model: str
    holds_n_m: float
    """The largest torque against the weight alone, as if the robot stood still."""
    holds_at_s: float
    holds_ratio: float | None
    """Of what the servo holds at that voltage."""
    torque_n_m: float
    """The torque where it is the largest part of what the servo has; if that is not known, the
    largest."""
    at_s: float
    speed_deg_s: float
    has_n_m: float | None
    """What the servo has then."""
    ratio: float | None
    gives_way_deg: float | None
    """How far the weight pulls the horn at most, before feedback makes up for it."""
    warmest_c: float | None
    """Where its temperature ends up if the show is repeated without a rest."""
    hot_after_s: float | None
    """When it is then hotter than its `temperature_max_c`; None: never."""


class PlanLoad(Struct, frozen=True, kw_only=True):
    """What a plan asks of all servos of a robot, over its first pass and one more."""

    supply_v: float
    servos: tuple[ServoLoad, ...]
    current_max_a: float
    current_max_at_s: float
    current_mean_a: float
    allowed_a: float | None
    """What the supply of the robot gives; None: the robot file does not say."""
    weightless: tuple[str, ...]
    """Links that joints move whose mass is not known."""
    assumed: ServoAssumptions


def torque_curves(
    trajectory: Trajectory, robot: Robot, times_s: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]] | None:
    """Return the torque of the servo of each joint, and the least and the largest it has then.

    They are infinite where they are not known. Of several servos behind a joint it is the one that
    is listed where the joint is. None, and what it raises: as for `plan_load`.
    """
    figure = _weighed(robot)
    if figure is None:
        return None
    motion = _ServoMotion(trajectory, robot, figure)
    torque, _, speed = motion.at(times_s)
    ends = [
        sign * _available(motion.servos, np.full_like(torque, sign), speed, robot.supply.voltage_v)
        for sign in (-1.0, 1.0)
    ]
    servos = {name: name for name in robot.joints}
    for one in robot.mechanisms.values():
        for index, name in enumerate(one.joints):
            servos[name] = one.servo_label(one.servos[min(index, len(one.servos) - 1)])
    columns = {name: motion.names.index(servo) for name, servo in servos.items()}
    return {
        name: (torque[:, column], ends[0][:, column], ends[1][:, column])
        for name, column in columns.items()
    }


def plan_load(
    trajectory: Trajectory, robot: Robot, assumed: ServoAssumptions | None = None
) -> PlanLoad | None:
    """Return what a plan asks of the servos; None: the robot has no masses, or stands on feet.

    Raises `InputError` where the URDF file of the robot is wrong or missing.
    """
    figure = _weighed(robot)
    if figure is None:
        return None
    assumed = assumed or ServoAssumptions()
    motion = _ServoMotion(trajectory, robot, figure)
    sums = _LoadSums(motion.servos, robot.supply.voltage_v, assumed)
    end_s = trajectory.first.duration_s
    if trajectory.loop != 1:
        end_s += trajectory.middle.duration_s
    steps = math.ceil(end_s / STEP_S) + 1
    for start in range(0, steps, BLOCK):
        times_s = np.minimum(np.arange(start, min(start + BLOCK, steps)) * STEP_S, end_s)
        sums.add(times_s, *motion.at(times_s))
    return PlanLoad(
        supply_v=robot.supply.voltage_v,
        servos=tuple(sums.servos(end_s)),
        current_max_a=sums.current_max_a,
        current_max_at_s=sums.current_max_at_s,
        current_mean_a=sums.current_sum_a / steps,
        allowed_a=robot.supply.current_max_a,
        weightless=_weightless(figure),
        assumed=assumed,
    )


def _weighed(robot: Robot) -> Figure | None:
    """Return the figure of a robot if its torques follow from it; None: they do not.

    One that stands on its feet pushes on the ground, which its figure does not know: what its legs
    bear is for `gait_physics`.
    """
    figure = figure_of(robot)
    return figure if figure is not None and figure.has_masses and not figure.feet else None


def _weightless(figure: Figure) -> tuple[str, ...]:
    """Return links that joints move and that fill something, without a mass."""
    solids = figure.solids()
    return tuple(
        link.name
        for link, own in zip(figure.links, solids, strict=True)
        if link.joint is not None and link.mass_kg is None and own
    )


class _ServoMotion:
    """Torque and speed of every servo of a robot during a plan."""

    def __init__(self, trajectory: Trajectory, robot: Robot, figure: Figure) -> None:
        self._trajectory = trajectory
        self._joints = tuple(robot.joints)
        self._tree = RigidTree(figure, self._joints)
        rests = {link.joint: link.rest_deg for link in reversed(figure.links)}
        self._rest_deg = np.array(
            [one.within_deg(rests.get(name, 0.0)) for name, one in robot.joints.items()]
        )
        self._columns = [self._joints.index(name) for name in trajectory.joints]
        self._mechanisms = [
            (
                mechanism,
                [self._joints.index(name) for name in mechanism.joints],
            )
            for mechanism in robot.mechanisms.values()
        ]
        behind = {name for one in robot.mechanisms.values() for name in one.joints}
        own = [name for name in self._joints if name not in behind]
        self._own = [self._joints.index(name) for name in own]
        of_servo = robot.servo_robot.joints
        labels = [
            (one.servo_label(servo), of_servo[servo])
            for one in robot.mechanisms.values()
            for servo in one.servos
        ]
        self.names = (*own, *(label for label, _ in labels))
        self.servos = {
            **{name: of_servo[name] for name in own},
            **dict(labels),
        }

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return torque, torque by the weight alone, and speed, (n, servos), deg/s and N·m.

        Joints that do not move in the plan are taken to stand where the figure has them at rest.
        """
        shape = (len(times_s), len(self._joints))
        deg, deg_s, deg_s2 = np.broadcast_to(self._rest_deg, shape).copy(), *np.zeros((2, *shape))
        for order, values in enumerate((deg, deg_s, deg_s2)):
            values[:, self._columns] = self._trajectory.sample(times_s, order)
        still = np.zeros(shape)
        torque = self._tree.torques_n_m(deg, deg_s, deg_s2)
        weight = self._tree.torques_n_m(deg, still, still)
        found = [[values[:, self._own]] for values in (torque, weight, deg_s)]
        for mechanism, columns in self._mechanisms:
            slopes = mechanism.transmission.slopes(deg[:, columns])
            # Work is the same on both sides; servos that share a joint share its torque.
            share = np.linalg.pinv(np.swapaxes(slopes, 1, 2))
            parts = ((share, torque), (share, weight), (slopes, deg_s))
            for group, (ratios, of_joint) in zip(found, parts, strict=True):
                group.append(np.einsum("nsj,nj->ns", ratios, of_joint[:, columns]))
        at_servo = [np.concatenate(group, axis=1) for group in found]
        return at_servo[0], at_servo[1], at_servo[2]


def _largest(servos: Sequence[Joint]) -> FloatArray:
    """Return what each servo holds at the nominal voltage; infinite: not known."""
    return np.array([STATIC_TORQUE_N_M.get(one.model.name, math.inf) for one in servos])


def _available(
    servos: dict[str, Joint], torque: FloatArray, speed: FloatArray, supply_v: float
) -> FloatArray:
    """Return the torque that each servo has at a speed, in the direction of `torque`."""
    share = supply_v / NOMINAL_V
    holds = share * _largest(list(servos.values()))
    free = share * np.array([one.model.speed_max_deg_s for one in servos.values()])
    left = 1.0 - np.sign(torque) * speed / free
    return np.asarray(holds * np.clip(left, LEAST_RATIO, 1.0))


class _LoadSums:
    """Gathers the largest and the mean of what the servos give, block by block."""

    def __init__(
        self, servos: dict[str, Joint], supply_v: float, assumed: ServoAssumptions
    ) -> None:
        self._servos, self._supply_v, self._assumed = servos, supply_v, assumed
        joints = list(servos.values())
        self._holds = _largest(joints)
        self._free = np.array([one.model.speed_max_deg_s for one in joints])
        self._a_per_n_m = np.array([_stall_a(one.model, assumed) for one in joints]) / self._holds
        count = len(joints)
        self._weight = np.zeros((2, count))
        """The largest torque by weight alone, and when."""
        self._worst = np.zeros((5, count))
        """The largest use of what a servo has: the use, torque, speed, what it has, when."""
        self._heat = _Heat(count, assumed)
        self.current_max_a = self.current_max_at_s = self.current_sum_a = 0.0

    def add(
        self, times_s: FloatArray, torque: FloatArray, weight: FloatArray, speed: FloatArray
    ) -> None:
        """Use some instants more."""
        columns = np.arange(len(self._servos))
        rows = np.abs(weight).argmax(axis=0)
        most = np.array([np.abs(weight)[rows, columns], times_s[rows]])
        self._weight = np.where(most[0] > self._weight[0], most, self._weight)
        has = _available(self._servos, torque, speed, self._supply_v)
        is_known = np.isfinite(self._holds)
        use = np.where(is_known, np.abs(torque) / np.where(is_known, has, 1.0), np.abs(torque))
        rows = use.argmax(axis=0)
        parts = (use, torque, speed, has)
        most = np.array([*(one[rows, columns] for one in parts), times_s[rows]])
        self._worst = np.where(most[0] > self._worst[0], most, self._worst)
        motor_a = self._a_per_n_m * np.abs(torque)
        motor_a += self._assumed.no_load_a * np.abs(speed) / self._free
        whole_a = motor_a.sum(axis=1) + self._assumed.idle_a * len(self._servos)
        row = int(whole_a.argmax())
        if whole_a[row] > self.current_max_a:
            self.current_max_a, self.current_max_at_s = float(whole_a[row]), float(times_s[row])
        self.current_sum_a += float(whole_a.sum())
        self._heat.add(motor_a)

    def servos(self, end_s: float) -> Iterator[ServoLoad]:
        """Yield what was found of each servo."""
        share = self._supply_v / NOMINAL_V
        for index, (name, joint) in enumerate(self._servos.items()):
            holds_n_m = share * float(self._holds[index])
            is_known = math.isfinite(holds_n_m)
            weight, weight_at_s = map(float, self._weight[:, index])
            use, torque, speed, has, at_s = map(float, self._worst[:, index])
            warmest_c, hot_after_s = self._heat.result(index, end_s, joint.temperature_max_c)
            yield ServoLoad(
                servo=name,
                model=joint.model.name,
                holds_n_m=weight,
                holds_at_s=weight_at_s,
                holds_ratio=weight / holds_n_m if is_known else None,
                torque_n_m=torque,
                at_s=at_s,
                speed_deg_s=speed,
                has_n_m=has if is_known else None,
                ratio=use if is_known else None,
                gives_way_deg=self._assumed.give_deg * weight / holds_n_m if is_known else None,
                warmest_c=warmest_c if is_known else None,
                hot_after_s=hot_after_s if is_known else None,
            )


def _stall_a(model: ServoModel, assumed: ServoAssumptions) -> float:
    """Return the current of a servo that gives all its torque; 0: nothing is known of it."""
    torque = STATIC_TORQUE_N_M.get(model.name)
    if torque is None:
        return 0.0
    known = SERVO_MODELS[STALL_MODEL]
    power = torque * model.speed_max_deg_s
    return assumed.stall_a * power / (STATIC_TORQUE_N_M[STALL_MODEL] * known.speed_max_deg_s)


class _Heat:
    """How far a pass of a plan warms each motor above the room, if it starts cold."""

    def __init__(self, count: int, assumed: ServoAssumptions) -> None:
        self._assumed = assumed
        self._keep = math.exp(-STEP_S / assumed.heating_s)
        self._state = np.zeros((1, count))
        self._steps = 0
        self._kept: list[FloatArray] = []
        self._kept_s: list[FloatArray] = []

    def add(self, motor_a: FloatArray) -> None:
        """Use the currents of some instants more, (n, servos)."""
        from scipy.signal import lfilter

        share = self._assumed.heating_c_per_a2 * (1.0 - self._keep)
        warmer, self._state = lfilter(
            [share], [1.0, -self._keep], motor_a**2, axis=0, zi=self._state
        )
        every = round(HEAT_STEP_S / STEP_S)
        rows = np.unique([*range(-self._steps % every, len(motor_a), every), len(motor_a) - 1])
        self._kept.append(warmer[rows])
        self._kept_s.append((self._steps + rows) * STEP_S)
        self._steps += len(motor_a)

    def result(self, index: int, end_s: float, most_c: float) -> tuple[float, float | None]:
        """Return the highest temperature of a motor that repeats the pass, and when it is too hot.

        What a pass leaves fades while the next ones add the same: the sum is a geometric one.
        """
        warmer = np.concatenate([kept[:, index] for kept in self._kept])
        at_s = np.concatenate(self._kept_s)
        pass_s = max(end_s, STEP_S)
        fading = np.exp(-at_s / self._assumed.heating_s)
        left = math.exp(-pass_s / self._assumed.heating_s)
        final = float(warmer[-1]) / (1.0 - left)
        warmest_c = self._assumed.ambient_c + float((warmer + final * fading).max())
        if warmest_c <= most_c:
            return warmest_c, None

        def is_hot(passes: int) -> FloatArray:
            before = final * (1.0 - left**passes)
            return np.asarray(self._assumed.ambient_c + warmer + before * fading > most_c)

        passes = bisect.bisect_left(range(PASSES_MAX), x=True, key=lambda n: bool(is_hot(n).any()))
        return warmest_c, passes * pass_s + float(at_s[is_hot(passes).argmax()])


def load_lines(load: PlanLoad) -> list[str]:
    """Return what a person reads of the load, the assumptions with it."""
    width = max(len(one.servo) for one in load.servos)
    lines = [
        f"load at {load.supply_v:g} V (assumed: the first link stands still and level; no "
        f"friction)",
        f"{'servo':{width}}  weight N·m (of)          hardest N·m (of, then)",
    ]
    lines += [_servo_line(one, load.supply_v, width) for one in load.servos]
    if load.weightless:
        lines.append(f"links without mass_kg count as weightless: {', '.join(load.weightless)}")
    lines += [_too_much(one) for one in load.servos if (one.ratio or 0.0) > 1.0]
    assumed = load.assumed
    lines.append(
        f"current of all servos: at most {load.current_max_a:.1f} A at {load.current_max_at_s:.3f} "
        f"s, {load.current_mean_a:.1f} A on average (assumed: {assumed.stall_a:g} A at the full "
        f"torque of an {STALL_MODEL})"
    )
    if load.allowed_a is not None and load.current_max_a > load.allowed_a:
        lines.append(
            f"warning: the supply gives {load.allowed_a:g} A (supply: current_max_a): its voltage "
            f"may fall so far at {load.current_max_at_s:.3f} s that servos restart"
        )
    slack = max(load.servos, key=lambda one: one.gives_way_deg or 0.0)
    if (slack.gives_way_deg or 0.0) >= GIVES_WAY_MIN_DEG:
        lines.append(
            f"its weight pulls {slack.servo} down by up to {slack.gives_way_deg:.1f} deg without "
            f"feedback, most of all servos (assumed: {assumed.give_deg:g} deg at full torque)"
        )
    hot = [one for one in load.servos if one.hot_after_s is not None]
    lines += [
        f"warning: {one.servo} is hot after {_minutes(one.hot_after_s or 0.0)} of this show "
        f"without a rest (assumed: {assumed.ambient_c:g} C before, {assumed.heating_c_per_a2:g} C "
        f"more for each A² in the end, by {_minutes(assumed.heating_s)} most of it)"
        for one in sorted(hot, key=lambda one: one.hot_after_s or 0.0)
    ]
    return lines


def _servo_line(one: ServoLoad, supply_v: float, width: int) -> str:
    if one.has_n_m is None or one.holds_ratio is None or one.ratio is None:
        return (
            f"{one.servo:{width}}  {one.holds_n_m:6.2f} {'':14}   {abs(one.torque_n_m):6.2f} at "
            f"{one.at_s:.3f} s; what an {one.model} has is not known"
        )
    holds = STATIC_TORQUE_N_M[one.model] * supply_v / NOMINAL_V
    return (
        f"{one.servo:{width}}  {one.holds_n_m:6.2f} ({holds:.2f}) {one.holds_ratio:6.0%}   "
        f"{abs(one.torque_n_m):6.2f} ({one.has_n_m:.2f}) {one.ratio:6.0%} at {one.at_s:.3f} s"
    )


def _too_much(one: ServoLoad) -> str:
    remedy = "let it move slower, or start and stop more gently"
    if (one.holds_ratio or 0.0) > 1.0:
        remedy = "it cannot hold that either: make the robot lighter, or take a stronger servo"
    return (
        f"warning: {one.servo} at {one.ratio or 0.0:.0%} at {one.at_s:.3f} s: it needs "
        f"{abs(one.torque_n_m):.2f} N·m at {abs(one.speed_deg_s):.0f} deg/s, where an {one.model} "
        f"has {one.has_n_m or 0.0:.2f}; {remedy}"
    )


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.0f} min" if seconds >= 120.0 else f"{seconds:.0f} s"
