"""A gait in the physics of MuJoCo: whether the robot stays upright, and where it gets.

The judge shares no code with the planner but the angles of its plan and the geometry of the legs.
Bodies are made of the legs of the gait: a box between the hips, a capsule for each link, a ball for
each foot. Each joint is driven as a servo does it: towards its target, late by the lag of its
response, with a torque that grows with the error up to what the servo holds and falls with its
speed. What no file says is a field of `PhysicsWorld`: each is an assumption, and stated.

Needs the extra `physics`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError, install_command
from lss_motion.robot.servo_models import MASS_KG, STATIC_TORQUE_N_M
from lss_motion.show.gait.kinematics import figure_of_legs

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.figure import Figure, Vector
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.001
"""Chosen: a fifth of the control period of a servo, at which contacts of hard feet are steady."""
SETTLE_S: Final = 0.5
"""The robot stands so long in its first pose before the gait begins."""
FALLEN_DEG: Final = 30.0
"""Chosen: a body that leans so far has fallen; no example leans further than 12 degrees by plan."""
CONTACT_RATIO: Final = 1.01
"""A foot whose middle is lower than this many radii presses on the ground."""
LINK_RADIUS_MM: Final = 8.0
BODY_HEIGHT_MM: Final = 40.0
"""Chosen: about the size of a servo. They say where masses are, and what touches the ground."""
MODEL_ASSUMED: Final = "LSS-ST1"
"""Assumption: a model whose data sheet is not known has the torque and the mass of this one."""


class PhysicsWorld(Struct, frozen=True, kw_only=True):
    """What is assumed of robot and ground. No file says it.

    `friction`      of feet on the ground; 0.8 is rubber on wood, 0.3 plastic on tiles
    `body_kg`       of body, battery and computer, without the servos of the legs
    `slope_deg`     how far the ground rises
    `uphill_deg`    where it rises: 0 ahead of the robot, 90 to its left
    `strength`      the torque of all servos against their data sheet: less with a low voltage
    `full_torque_deg`  the error at which a servo gives all its torque (its stiffness)
    `brake_s`       the damping of its control loop: the torque against the speed, by stiffness
    `inertia_kg_m2` of motor and gear, as it acts at the horn
    `foot_mm`       radius of the ball that is each foot
    """

    friction: float = 0.8
    body_kg: float = 0.6
    slope_deg: float = 0.0
    uphill_deg: float = 0.0
    strength: float = 1.0
    full_torque_deg: float = 5.0
    brake_s: float = 0.02
    inertia_kg_m2: float = 0.002
    foot_mm: float = 10.0


class WalkVerdict(Struct, frozen=True, kw_only=True):
    """What became of a gait in that world. Distances over the ground, from start to end.

    `slip_mm` is how far each foot has slid while it stood, over the whole gait; `torque_ratio` is
    the largest torque of each joint against what its servo holds, and `saturated_ratio` the share
    of the time in which any joint had no more to give.
    """

    is_upright: bool
    fell_at_s: float | None
    walked_mm: tuple[float, float]
    planned_mm: tuple[float, float]
    turned_deg: float
    planned_deg: float
    tilt_max_deg: float
    slip_mm: dict[str, float]
    torque_ratio: dict[str, float]
    saturated_ratio: float

    @property
    def off_mm(self) -> float:
        """The distance between the planned and the reached place."""
        return math.dist(self.walked_mm, self.planned_mm)


def judged_walk(
    gait: Gait,
    robot: Robot,
    passages: Sequence[Paced],
    trajectory: Trajectory,
    world: PhysicsWorld | None = None,
) -> WalkVerdict:
    """Play one pass of a planned gait in MuJoCo.

    Raises `InputError` where the extra `physics` is missing, and for a gait without an end.
    """
    mujoco = _mujoco()
    world = world or PhysicsWorld()
    duration_s = trajectory.duration_s
    if not math.isfinite(duration_s):
        raise InputError("a gait without an end has no place at which it arrives; give cycles")
    names = [name for leg in gait.legs for name in leg.joints]
    joints = [robot.joints[name] for name in names]
    figure = figure_of_legs(gait.legs)
    columns = [trajectory.joints.index(name) for name in names]
    start_deg = trajectory.sample(np.zeros(1))[0, columns]
    model = mujoco.MjModel.from_xml_string(_mjcf(figure, joints, start_deg, world))
    run = _PhysicsRun(mujoco, model, figure, joints, world)
    times_s = np.arange(0.0, duration_s + SETTLE_S, STEP_S)
    lags_s = np.array([joint.response.lag_s for joint in joints])
    targets = np.empty((len(times_s), len(names)))
    for column, lag_s in enumerate(lags_s):
        at_s = np.clip(times_s - SETTLE_S - lag_s, 0.0, duration_s)
        targets[:, column] = trajectory.sample(at_s)[:, columns[column]]
    fell_at_s = run.play(targets)
    planned_mm, planned_deg = _planned(passages)
    walked_mm, turned_deg = run.reached()
    return WalkVerdict(
        is_upright=fell_at_s is None,
        fell_at_s=fell_at_s,
        walked_mm=walked_mm,
        planned_mm=planned_mm,
        turned_deg=turned_deg,
        planned_deg=planned_deg,
        tilt_max_deg=run.tilt_max_deg,
        slip_mm=dict(zip([leg.name for leg in gait.legs], map(float, run.slip_mm), strict=True)),
        torque_ratio=dict(zip(names, map(float, run.torque_ratio), strict=True)),
        saturated_ratio=run.saturated / max(run.steps, 1),
    )


def verdict_lines(verdict: WalkVerdict, world: PhysicsWorld) -> list[str]:
    """Return what a person reads of a verdict, the assumptions first."""
    slope = f", ground rising by {world.slope_deg:g} deg" if world.slope_deg else ""
    slope += f" to {world.uphill_deg:g} deg" if world.slope_deg and world.uphill_deg else ""
    lines = [
        f"physics (MuJoCo; assumed: friction {world.friction:g}, body {world.body_kg:g} kg, torque "
        f"{world.strength:g} of the data sheet{slope}):"
    ]
    if verdict.fell_at_s is not None:
        lines.append(f"  it falls over after {verdict.fell_at_s:.2f} s")
        return lines
    ahead, left = verdict.walked_mm
    to_ahead, to_left = verdict.planned_mm
    lines.append(
        f"  upright; {ahead:.0f} mm ahead and {left:.0f} mm left of {to_ahead:.0f} and "
        f"{to_left:.0f}, turned by {verdict.turned_deg:.1f} of {verdict.planned_deg:.1f} deg; "
        f"leans by {verdict.tilt_max_deg:.1f} deg at most"
    )
    worst = max(verdict.slip_mm, key=lambda leg: verdict.slip_mm[leg])
    hardest = max(verdict.torque_ratio, key=lambda joint: verdict.torque_ratio[joint])
    lines.append(
        f"  feet slip by {verdict.slip_mm[worst]:.0f} mm at most ({worst}); hardest joint "
        f"{hardest}, {verdict.torque_ratio[hardest]:.0%} of its torque"
    )
    return lines


def _mujoco() -> Any:  # noqa: ANN401  (it has no types)
    try:
        import mujoco
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise InputError(f"physics need MuJoCo: {install_command('physics')}") from None
    return mujoco


def _planned(passages: Sequence[Paced]) -> tuple[tuple[float, float], float]:
    """Return the place and the turn in degrees at the end of all passages."""
    x, y, heading = 0.0, 0.0, 0.0
    for part in passages:
        places = part.passage.at(np.array([float(part.times_s[0]), float(part.times_s[-1])])).places
        ahead, left = places[1, :2] - places[0, :2]
        cosine, sine = math.cos(heading - places[0, 2]), math.sin(heading - places[0, 2])
        x, y = x + cosine * ahead - sine * left, y + sine * ahead + cosine * left
        heading += places[1, 2] - places[0, 2]
    return (float(x), float(y)), math.degrees(heading)


class _PhysicsRun:
    """One run: steps the world and measures it."""

    def __init__(
        self,
        mujoco: Any,  # noqa: ANN401
        model: Any,  # noqa: ANN401
        figure: Figure,
        joints: Sequence[Joint],
        world: PhysicsWorld,
    ) -> None:
        self._mujoco, self._model = mujoco, model
        self._data = mujoco.MjData(model)
        links = [link for link in figure.links if link.joint is not None]
        self._ratios = np.array([link.ratio for link in links])
        self._rests = np.array([link.rest_deg for link in links])
        self._torque = world.strength * np.array(
            [
                STATIC_TORQUE_N_M.get(joint.model.name, STATIC_TORQUE_N_M[MODEL_ASSUMED])
                for joint in joints
            ]
        )
        self._free = np.radians([joint.model.speed_max_deg_s for joint in joints])
        self._stiffness = self._torque / math.radians(world.full_torque_deg)
        self._brake_s = world.brake_s
        self._feet = [model.geom(f"foot {index}").id for index in range(len(figure.feet))]
        self._radius_m = world.foot_mm / 1000.0
        self.slip_mm = np.zeros(len(figure.feet))
        self.torque_ratio = np.zeros(len(joints))
        self.tilt_max_deg, self.saturated, self.steps = 0.0, 0, 0
        self._start, self._velocity = np.zeros(3), np.zeros(6)

    def play(self, targets_deg: FloatArray) -> float | None:
        """Follow joint angles, one row a step; return when the robot fell, None if it did not."""
        data, model = self._data, self._model
        wanted = np.radians(self._ratios * (targets_deg - self._rests))
        data.qpos[7:] = wanted[0]
        self._mujoco.mj_forward(model, data)
        first = round(SETTLE_S / STEP_S)
        for step, target in enumerate(wanted):
            data.ctrl[:] = self._torques(target, is_measured=step >= first)
            self._mujoco.mj_step(model, data)
            if step == first:
                self._start = np.array([*data.qpos[:2], self._yaw()])
            if step >= first:
                self._measure_slip()
                upright = float(data.xmat[1].reshape(3, 3)[2, 2])
                tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, upright))))
                self.tilt_max_deg = max(self.tilt_max_deg, tilt_deg)
                if tilt_deg > FALLEN_DEG:
                    return (step - first) * STEP_S
        return None

    def _measure_slip(self) -> None:
        """Add how far the lowest point of each foot that stands has slid in this step."""
        for index, geom in enumerate(self._feet):
            if self._data.geom_xpos[geom][2] > CONTACT_RATIO * self._radius_m:
                continue
            self._mujoco.mj_objectVelocity(
                self._model, self._data, self._mujoco.mjtObj.mjOBJ_GEOM, geom, self._velocity, 0
            )
            turn, speed = self._velocity[:3], self._velocity[3:]
            slide = math.hypot(
                speed[0] - turn[1] * self._radius_m, speed[1] + turn[0] * self._radius_m
            )
            self.slip_mm[index] += 1000.0 * STEP_S * slide

    def _torques(self, target: FloatArray, *, is_measured: bool) -> FloatArray:
        """Return what the servos give: by their error, at most what their speed leaves."""
        position, speed = self._data.qpos[7:], self._data.qvel[6:]
        wished = self._stiffness * (target - position - self._brake_s * speed)
        left = self._torque * np.clip(1.0 - np.sign(wished) * speed / self._free, 0.0, 1.0)
        given = np.clip(wished, -left, left)
        if is_measured:
            self.steps += 1
            self.saturated += bool((np.abs(wished) > left).any())
            self.torque_ratio = np.maximum(self.torque_ratio, np.abs(given) / self._torque)
        return np.asarray(given)

    def _yaw(self) -> float:
        rotation = self._data.xmat[1].reshape(3, 3)
        return math.atan2(rotation[1, 0], rotation[0, 0])

    def reached(self) -> tuple[tuple[float, float], float]:
        """Return how far it came, in the frame of its start in mm, and its turn in degrees."""
        x, y = 1000.0 * (self._data.qpos[:2] - self._start[:2])
        cosine, sine = math.cos(self._start[2]), math.sin(self._start[2])
        turn = math.degrees(self._yaw() - self._start[2])
        return (
            (float(cosine * x + sine * y), float(cosine * y - sine * x)),
            (turn + 180.0) % 360.0 - 180.0,
        )


def _mjcf(
    figure: Figure, joints: Sequence[Joint], start_deg: FloatArray, world: PhysicsWorld
) -> str:
    """Return the model as text, standing on its lowest foot."""
    angles = {joint.name: float(angle) for joint, angle in zip(joints, start_deg, strict=True)}
    placed = figure.placed(angles)
    lowest = min(
        float((placed[link][0] @ np.array(point) + placed[link][1])[2])
        for link, point in figure.feet
    )
    slope = math.radians(world.slope_deg)
    uphill = math.radians(world.uphill_deg)
    down = 9.81 * math.sin(slope)
    gravity = (
        f"{-down * math.cos(uphill):.6g} {-down * math.sin(uphill):.6g} "
        f"{-9.81 * math.cos(slope):.6g}"
    )
    hips = np.array(figure.links[0].lines_mm[0])
    half = np.maximum(np.abs(hips[:, :2]).max(axis=0), 0.5 * BODY_HEIGHT_MM) / 1000.0
    kilograms = {
        joint.name: MASS_KG.get(joint.model.name, MASS_KG[MODEL_ASSUMED]) for joint in joints
    }
    motors = "".join(f'<motor joint="{j.name}" name="motor {j.name}"/>' for j in joints)
    return (
        f'<mujoco><option timestep="{STEP_S}" gravity="{gravity}" integrator="implicitfast"/>'
        f'<default><geom friction="{world.friction} 0.005 0.0001"/>'
        f'<joint armature="{world.inertia_kg_m2}"/></default><worldbody>'
        '<geom name="ground" type="plane" size="0 0 1" contype="1" conaffinity="1"/>'
        f'<body name="body" pos="0 0 {(world.foot_mm - lowest) / 1000.0:.6g}"><freejoint/>'
        f'<geom type="box" size="{half[0]:.6g} {half[1]:.6g} {BODY_HEIGHT_MM / 2000.0:.6g}" '
        f'mass="{world.body_kg}" contype="2" conaffinity="1"/>'
        f"{''.join(_bodies(figure, 0, kilograms, world))}</body></worldbody>"
        f"<actuator>{motors}</actuator></mujoco>"
    )


def _bodies(
    figure: Figure, parent: int, kilograms: dict[str, float], world: PhysicsWorld
) -> Iterator[str]:
    """Yield the elements of the links below one."""
    for index, link in enumerate(figure.links):
        if link.parent != parent or link.joint is None:
            continue
        foot = next((n for n, (at, _) in enumerate(figure.feet) if at == index), None)
        end = link.lines_mm[0][-1]
        w, x, y, z = _quaternion(np.array(link.rotation))
        yield (
            f'<body name="{link.name}" pos="{_metres(link.origin_mm)}" '
            f'quat="{w:.9g} {x:.9g} {y:.9g} {z:.9g}">'
            f'<joint name="{link.joint}" type="hinge" axis="{" ".join(map(str, link.axis))}"/>'
            f'<geom type="capsule" fromto="0 0 0 {_metres(end)}" size="{LINK_RADIUS_MM / 1000.0}" '
            f'mass="{kilograms[link.joint]}" contype="2" conaffinity="1"/>'
        )
        if foot is not None:
            yield (
                f'<geom name="foot {foot}" type="sphere" pos="{_metres(end)}" '
                f'size="{world.foot_mm / 1000.0}" mass="0.005" contype="2" conaffinity="1"/>'
            )
        yield from _bodies(figure, index, kilograms, world)
        yield "</body>"


def _metres(point_mm: Vector) -> str:
    return " ".join(f"{value / 1000.0:.6g}" for value in point_mm)


def _quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return w, x, y and z of a rotation about z, as the legs of a gait have it."""
    half = 0.5 * math.atan2(rotation[1, 0], rotation[0, 0])
    return math.cos(half), 0.0, 0.0, math.sin(half)
