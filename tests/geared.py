"""Random robots with mechanisms and random shows, and a judge that shares no code with planning.

The judge gets angles of joints only. It finds the servo angles by itself: a four-bar by turning the
crank until the rod fits, a table by B-splines, a matrix by solving the equations the other way.

    python -m tests.geared 300
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.api import load_sequence
from lss_motion.robot.load import load_robot

SPEED_S = 0.001
EXCESS_MAX_RATIO = 1.0011
"""The verifier allows 1.001."""


def random_four_bar(rng: np.random.Generator) -> dict[str, Any]:
    base = rng.uniform(25, 60)
    return {
        "kind": "four_bar",
        "crank_mm": round(rng.uniform(8, 18), 1),
        "rod_mm": round(base + rng.uniform(-6, 6), 1),
        "rocker_mm": round(rng.uniform(8, 22), 1),
        "base_mm": round(base, 1),
        "offset_deg": round(rng.uniform(-20, 30), 1),
        "turns": str(rng.choice(["towards", "away"])),
        "rod": str(rng.choice(["open", "crossed"])),
    }


def random_table(rng: np.random.Generator, low: float, high: float) -> dict[str, Any]:
    count = int(rng.integers(3, 9))
    joint = np.linspace(low, high, count)
    joint[1:-1] += rng.uniform(-0.2, 0.2, count - 2) * (high - low) / (count - 1)
    bend = rng.uniform(-0.5, 0.5) / (high - low)
    servo = rng.uniform(0.4, 3.5) * (joint + bend * (joint - low) ** 2) + rng.uniform(-20, 20)
    sign = rng.choice([1.0, -1.0])
    return {
        "joint_deg": joint.round(2).tolist(),
        "servo_deg": (sign * servo).round(1).tolist(),
    }


def random_grid(rng: np.random.Generator, path: Path, joints: dict[str, Any]) -> None:
    axes = [np.linspace(*joint["range_deg"], int(rng.integers(4, 8))) for joint in joints.values()]
    a, b, warp = rng.uniform(0.8, 1.5), rng.uniform(0.5, 1.2), rng.uniform(-0.006, 0.006, 4)
    rows = [",".join([*(f"{name}_deg" for name in joints), "a_deg", "b_deg"])]
    for x in axes[0]:
        for y in axes[1]:
            first = a * x + b * y + warp[0] * x * y + warp[1] * y**2
            second = a * x - b * y + warp[2] * x**2 + warp[3] * x * y
            rows.append(f"{x},{y},{first:.3f},{second:.3f}")
    path.write_text("\n".join(rows), encoding="utf-8")


def random_robot(rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Return the keys of a robot file; its table stands in the folder."""
    joints: dict[str, Any] = {}
    mechanisms: dict[str, Any] = {}

    def joint(name: str, **more: Any) -> dict[str, Any]:
        low = -round(rng.uniform(10, 40), 1)
        joints[name] = {
            "range_deg": [low, round(low + rng.uniform(25, 70), 1)],
            "speed_max_deg_s": round(rng.uniform(40, 250), 1),
            "accel_max_deg_s2": round(rng.uniform(150, 1000), 0),
            **more,
        }
        return joints[name]

    def limits() -> dict[str, Any]:
        if rng.random() < 0.3:
            return {}
        return {
            "speed_max_deg_s": round(rng.uniform(40, 250), 1),
            "accel_max_deg_s2": round(rng.uniform(100, 990), 0),
        }

    joint("plain", id=1)
    joint("turret", id=2, ratio=round(rng.uniform(0.3, 3.0), 2), servo=limits())
    jaw = joint("jaw", id=3, turns="powered", servo=limits())
    jaw["linkage"] = random_table(rng, *jaw["range_deg"])
    joint("lid", id=4, linkage=random_four_bar(rng), servo=limits())
    joint("tilt"), joint("roll"), joint("arm"), joint("yaw"), joint("pitch")
    sign = float(rng.choice([1.0, -1.0]))
    mechanisms["neck"] = {
        "kind": "differential",
        "joints": ["tilt", "roll"],
        "servos": {
            "left": {"id": 5, "turns": "powered", **limits()},
            "right": {"id": 6, "direction": -1, "turns": "powered", **limits()},
        },
        "matrix": [
            [round(rng.uniform(0.6, 2.5), 2), round(sign * rng.uniform(0.6, 2.5), 2)],
            [round(rng.uniform(0.6, 2.5), 2), round(-sign * rng.uniform(0.6, 2.5), 2)],
        ],
    }
    shared = limits()
    mechanisms["shoulder"] = {
        "kind": "pair",
        "joint": "arm",
        "servos": {
            "front": {"id": 7, **shared},
            "back": {"id": 8, "direction": -1, "zero_deg": 0.4, **shared},
        },
    }
    if rng.random() < 0.5:
        mechanisms["shoulder"]["ratio"] = round(rng.uniform(0.5, 2.0), 2)
    mechanisms["eyes"] = {
        "kind": "table",
        "joints": ["yaw", "pitch"],
        "servos": {"a": {"id": 9, **limits()}, "b": {"id": 10, **limits()}},
        "file": "eyes.csv",
    }
    random_grid(rng, folder / "eyes.csv", {name: joints[name] for name in ("yaw", "pitch")})
    defaults = {"model": "LSS-HS1"}
    return {"robot": "r", "defaults": defaults, "joints": joints, "mechanisms": mechanisms}


def loadable(rng: np.random.Generator, folder: Path) -> tuple[dict[str, Any], Path]:
    """Return the keys of a random robot file that can be loaded, and its file."""
    path = folder / "robot.yaml"
    while True:
        content = random_robot(rng, folder)
        path.write_text(json.dumps(content, default=float), encoding="utf-8")
        try:
            load_robot(path)
        except InputError:
            continue
        return content, path


def random_show(rng: np.random.Generator, content: dict[str, Any], path: Path) -> Path:
    """Write a show that moves some joints, all of a mechanism or none, often too fast."""
    whole = [["plain"], ["turret"], ["jaw"], ["lid"], ["tilt", "roll"], ["arm"], ["yaw", "pitch"]]
    chosen = [names for names in whole if rng.random() < 0.7] or whole
    names = [name for group in chosen for name in group]
    frames: list[dict[str, Any]] = []
    at_s = 0.0
    for index in range(int(rng.integers(3, 8))):
        some = names if index == 0 else [name for name in names if rng.random() < 0.8]
        deg = {}
        for name in some or names[:1]:
            low, high = content["joints"][name]["range_deg"]
            deg[name] = round(float(rng.uniform(low, high)), 1)
        frame: dict[str, Any] = {"at_s": round(at_s, 2), "deg": deg}
        if index and rng.random() < 0.3:
            frame["ease"] = str(rng.choice(["linear", "smooth"]))
        if rng.random() < 0.2:
            frame["hold_s"] = 0.3
        frames.append(frame)
        at_s += round(float(rng.uniform(0.35, 1.5)), 2)
    show: dict[str, Any] = {"sequence": "s", "robot": "robot.yaml", "keyframes": frames}
    if rng.random() < 0.3:
        show["timing"] = "fastest"
        for frame in frames:
            del frame["at_s"]
    target = path.parent / "show.yaml"
    target.write_text(json.dumps(show), encoding="utf-8")
    return target


def crank_of(linkage: dict[str, Any], joint_deg: np.ndarray) -> np.ndarray:
    """Return crank angles of a four-bar, by bisection on the length of the rod."""
    sign = -1.0 if linkage["turns"] == "away" else 1.0
    rocker = np.radians(90.0 - linkage["offset_deg"] + sign * joint_deg)
    tip = np.stack([np.cos(rocker), np.sin(rocker)]) * linkage["rocker_mm"]
    tip[0] += linkage["base_mm"]

    def error(crank: np.ndarray) -> np.ndarray:
        own = linkage["crank_mm"] * np.stack([np.cos(crank), np.sin(crank)])
        return np.asarray(np.hypot(*(tip - own)) - linkage["rod_mm"])

    # The rod is shortest where the crank points at the tip, longest half a turn further.
    pointing = np.arctan2(tip[1], tip[0])
    low, high = pointing, pointing + (np.pi if linkage["rod"] == "open" else -np.pi)
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_short = error(middle) < 0.0
        low, high = np.where(is_short, middle, low), np.where(is_short, high, middle)
    return np.degrees(np.unwrap(0.5 * (low + high)))


def judged_servos(
    content: dict[str, Any], folder: Path, deg: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the angles of ideal servos of joint angles over time, as the judge finds them."""
    found: dict[str, np.ndarray] = {}
    for name, entry in content["joints"].items():
        if name not in deg or "id" not in entry:
            continue
        if "ratio" in entry:
            found[name] = entry["ratio"] * deg[name]
        elif entry.get("linkage", {}).get("kind") == "four_bar":
            found[name] = crank_of(entry["linkage"], deg[name])
        elif "linkage" in entry:
            points = entry["linkage"]["joint_deg"], entry["linkage"]["servo_deg"]
            found[name] = make_interp_spline(*points, k=min(3, len(points[0]) - 1))(deg[name])
    for name, entry in content["mechanisms"].items():
        joints = entry.get("joints") or [entry["joint"]]
        if joints[0] in deg:
            angles = judged_mechanism(entry, folder, np.stack([deg[joint] for joint in joints]))
            for servo, one in zip(entry["servos"], angles, strict=True):
                found[f"{name}.{servo}"] = one
    return found


def judged_mechanism(entry: dict[str, Any], folder: Path, own: np.ndarray) -> np.ndarray:
    """Return the angles of the servos of a mechanism, (servos, n)."""
    if entry["kind"] == "differential":
        return np.linalg.solve(np.linalg.inv(np.array(entry["matrix"])), own)
    if entry["kind"] == "pair":
        return np.tile(entry.get("ratio", 1.0) * own, (2, 1))
    rows = np.loadtxt(folder / entry["file"], delimiter=",", skiprows=1)
    axes = [np.unique(rows[:, 0]), np.unique(rows[:, 1])]
    tables = [rows[:, 2 + k].reshape(len(axes[0]), -1) for k in range(2)]
    return np.stack([RectBivariateSpline(*axes, table).ev(*own) for table in tables])


def servo_limits(content: dict[str, Any], servo: str) -> tuple[float, float]:
    mechanism, _, short = servo.partition(".")
    entry = content["joints"][servo].get("servo", {}) if not short else {}
    if short:
        entry = content["mechanisms"][mechanism]["servos"][short]
    # The ramps of a servo have steps of 10 deg/s²; what is between is rounded down.
    return entry.get("speed_max_deg_s", 360.0), entry.get("accel_max_deg_s2", 1000.0) // 10 * 10


def joint_limits(content: dict[str, Any], name: str) -> tuple[float, float]:
    entry = content["joints"][name]
    speed, accel = entry["speed_max_deg_s"], entry["accel_max_deg_s2"]
    if name == "plain":
        return speed, accel // 10 * 10
    scale = entry.get("ratio")
    if name == "arm":
        scale = content["mechanisms"]["shoulder"].get("ratio", 1.0)
    # Of a fixed ratio the servo gets no more than its joint needs, in those steps.
    return speed, accel if scale is None else min(accel, accel * scale // 10 * 10 / scale)


def broken(content: dict[str, Any], folder: Path, names: list[str], deg: np.ndarray) -> list[str]:
    """Return the limits that angles at 1 kHz break, (n, joints)."""
    angles = dict(zip(names, deg.T, strict=True))
    rows: list[tuple[str, np.ndarray, float, float]] = []
    for name, own in angles.items():
        entry = content["joints"][name]
        low, high = entry["range_deg"]
        if own.min() < low - 1e-6 or own.max() > high + 1e-6:
            rows.append((f"{name} range", own, 0.0, 0.0))
        rows.append((name, own, *joint_limits(content, name)))
    for servo, own in judged_servos(content, folder, angles).items():
        rows.append((f"servo {servo}", own, *servo_limits(content, servo)))
    found = []
    for name, own, speed_max, accel_max in rows:
        speed = np.abs(np.diff(own)).max() / SPEED_S
        # Rounding of an angle by 1e-12 deg is 4e-6 deg/s² here; of a bisected one 1e-3.
        accel = np.abs(np.diff(own, 2)).max() / SPEED_S**2 - 1e-2
        if speed > EXCESS_MAX_RATIO * speed_max:
            found.append(f"{name}: {speed:.2f} of {speed_max:.2f} deg/s")
        if accel > EXCESS_MAX_RATIO * accel_max:
            found.append(f"{name}: {accel:.2f} of {accel_max:.2f} deg/s²")
    return found


def judge(seed: int, folder: Path) -> tuple[list[str], float]:
    """Return what a random robot breaks in a random show, and the time over the optimum."""
    rng = np.random.default_rng(seed)
    content, path = loadable(rng, folder)
    show = random_show(rng, content, path)
    robot = load_robot(path)
    trajectory = plan(load_sequence(show), robot)
    times_s = np.arange(-0.002, trajectory.duration_s + 0.003, SPEED_S)
    faults = broken(content, folder, list(trajectory.joints), trajectory.sample(times_s))
    return faults, over_optimum(content, folder, trajectory)


def over_optimum(content: dict[str, Any], folder: Path, trajectory: Any) -> float:
    """Return the time of a `fastest` show over the optimum of its path on a fine grid."""
    if any(mark.authored_s is not None for mark in trajectory.marks):
        return 1.0
    from lss_motion.planning.trajectory.solver import Cells, fastest_squares

    path = trajectory.first.path
    parts = [
        np.linspace(low, high, max(200, round(800 * (high - low))))[:-1]
        for low, high in zip(path.knots_s[:-1], path.knots_s[1:], strict=True)
    ]
    grid_s = np.append(np.concatenate(parts), path.knots_s[-1])
    step_s = 1e-5
    names = list(trajectory.joints)

    def rows(at_s: np.ndarray) -> np.ndarray:
        deg = path.evaluate(at_s)
        own = judged_servos(content, folder, dict(zip(names, deg.T, strict=True)))
        return np.column_stack([deg, *own.values()])

    own = judged_servos(content, folder, dict(zip(names, path.evaluate(grid_s).T, strict=True)))
    limits = [joint_limits(content, n) for n in names]
    limits += [servo_limits(content, servo) for servo in own]
    speed_max, accel_max = np.array(limits).T
    inner_s = np.diff(grid_s) / 8.0
    sides = []
    for at_s, sign in ((grid_s[:-1], 1.0), (grid_s[1:], -1.0)):
        step = sign * np.minimum(inner_s, step_s * 40)
        a, b, c = (rows(at_s + k * step) for k in (0.0, 1.0, 2.0))
        second = (c - 2 * b + a) / (step**2)[:, None]
        first = (b - a) / step[:, None] - 0.5 * second * step[:, None]
        sides.append((first, second))
    (left, left_bend), (right, right_bend) = sides
    ratio = np.zeros(len(grid_s))
    ratio[:-1] = (np.abs(left) / speed_max).max(axis=1)
    ratio[1:] = np.maximum(ratio[1:], (np.abs(right) / speed_max).max(axis=1))
    caps = 1.0 / np.maximum(ratio, 1e-2) ** 2
    held_s = sum(mark.hold_s for mark in trajectory.marks)
    # At a hold where the path itself does not rest, it must be stopped.
    clock = trajectory.first.clock
    reached = np.array([mark.planned_s for mark in trajectory.marks if mark.hold_s > 0.0])
    places_s = np.append(clock.positions(reached)[0], grid_s[[0, -1]])
    for place_s in places_s:
        at = int(np.argmin(np.abs(grid_s - place_s)))
        if np.abs(np.where(at < len(left), left[min(at, len(left) - 1)], right[-1])).max() > 1e-3:
            caps[at] = 0.0

    def cells(low: int, high: int) -> Cells:
        part = slice(low, high)
        return Cells(*(x[part] / accel_max for x in (left, right, left_bend, right_bend)))

    squares = fastest_squares(grid_s, cells, caps, joints=len(accel_max))
    rates = np.sqrt(squares)
    best_s = float((2.0 * np.diff(grid_s) / np.maximum(rates[:-1] + rates[1:], 1e-9)).sum())
    return float((trajectory.duration_s - held_s) / best_s)


def main() -> int:
    """Judge so many seeds, and say what is broken."""
    count, first = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    bad, worst = 0, 1.0
    for seed in range(first, first + count):
        with tempfile.TemporaryDirectory() as folder:
            try:
                faults, over = judge(seed, Path(folder))
            except Exception as error:  # noqa: BLE001  (a seed that fails is a finding)
                faults, over = [f"{type(error).__name__}: {error}"], 1.0
        worst = max(worst, over)
        if faults or over > 1.02:
            bad += 1
            sys.stdout.write(f"{seed} {over:.4f} {'; '.join(faults)}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{count} seeds, {bad} bad, time over the optimum at most {worst:.4f}\n")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main())
