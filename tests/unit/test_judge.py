"""The independent judge accepts good runs, and objects to every kind of bad one."""

from __future__ import annotations

import ast
import copy
import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from judge.recording import recording_of
from judge.verdict import objections

TOOLS = Path(__file__).resolve().parents[2] / "tools"
STEP_S = 0.005
END_S = 6.0

ROBOT = {
    "robot": "three",
    "buses": {"main": {"baud_bps": 115200}},
    "defaults": {"speed_max_deg_s": 100, "accel_max_deg_s2": 400, "range_deg": [-60, 60]},
    "joints": {
        "timed": {"id": 1, "zero_deg": 10, "direction": -1},
        "pro": {"id": 2, "model": "LSS-P-S1"},
        "streamed": {"id": 3, "drive": "streamed", "accel_max_deg_s2": 1500},
        "stepped": {"id": 209, "model": "LSS-2IO", "drive": "stepped"},
    },
}


def trapezoid(at_s, from_deg, to_deg, speed_deg_s, accel_deg_s2):
    """Return where a horn is that moves once, from rest to rest."""
    way = abs(to_deg - from_deg)
    peak = min(speed_deg_s, (way * accel_deg_s2) ** 0.5)
    ramp_s = peak / accel_deg_s2
    cruise_s = way / peak - ramp_s
    angles = []
    for index in range(int(END_S / STEP_S)):
        t = index * STEP_S - at_s
        if t <= 0:
            done = 0.0
        elif t < ramp_s:
            done = 0.5 * accel_deg_s2 * t * t
        elif t < ramp_s + cruise_s:
            done = peak * (t - 0.5 * ramp_s)
        else:
            left_s = max(2 * ramp_s + cruise_s - t, 0.0)
            done = way - 0.5 * accel_deg_s2 * left_s**2
        angles.append(from_deg + (done if to_deg > from_deg else -done))
    return angles


def filtered(moves, from_deg, count):
    """Return where a horn is that the filter of EM0 leads: moves are (instant, degrees)."""
    angles, x, target = [], from_deg, from_deg
    for index in range(int(END_S / STEP_S)):
        now_s = index * STEP_S
        target = next((deg for at_s, deg in reversed(moves) if at_s <= now_s), target)
        if index % 4 == 0:
            before, x = x, (x * (count - 1) + target) / count
        angles.append(before + (x - before) * (index % 4 + 1) / 4)
    return angles


GLIDE = [(2.0 + 0.02 * i, round(0.8 * i, 1)) for i in range(50)]
"""A bare D every 20 ms at 40 deg/s."""

GOOD = {
    "end_s": END_S,
    "buses": {"main": {"baud_bps": 115200, "written": []}},
    "servos": [
        {
            "bus": "main",
            "id": 1,
            "received": [
                [0.1, "#1EM1\r"],
                [0.11, "#1AA40\r"],
                [0.12, "#1AD40\r"],
                [0.13, "#1SD1000\r"],
                [2.0, "#1D-300T1000\r"],
                [5.0, "#1H\r"],
            ],
            "horn_deg": trapezoid(2.0, 10.0, -30.0, 40.0, 400.0),
        },
        {
            "bus": "main",
            "id": 2,
            "received": [
                [0.14, "#2AA40000\r"],
                [0.15, "#2AD40000\r"],
                [0.16, "#2SD10000\r"],
                [2.0, "#2D3000T1000\r"],
                [5.0, "#2H\r"],
            ],
            "horn_deg": trapezoid(2.0, 0.0, 30.0, 30.0, 400.0),
        },
        {
            "bus": "main",
            "id": 3,
            "received": [
                [0.17, "#3FPC4\r"],
                [0.18, "#3SD1000\r"],
                [0.19, "#3EM0\r"],
                *([round(at_s, 3), f"#3D{round(10 * deg)}\r"] for at_s, deg in GLIDE),
                [5.0, "#3H\r"],
            ],
            "horn_deg": filtered(GLIDE, 0.0, 4),
        },
        {
            "bus": "main",
            "id": 209,
            "received": [[2.0 + 0.02 * i, f"#209D{10 * (i // 2)}\r"] for i in range(50)],
        },
    ],
}


def record():
    """Return the good run, all of whose bytes the host wrote."""
    run = copy.deepcopy(GOOD)
    written = sorted(line for servo in run["servos"] for line in servo["received"])
    run["buses"]["main"]["written"] = [[at_s - 0.002, text] for at_s, text in written]
    return run


def servo(run, servo_id):
    return next(one for one in run["servos"] if one["id"] == servo_id)


def swap(run, servo_id, old, new):
    """Let the host have written, and the servo have received, another line; None: no line."""
    lists = (servo(run, servo_id)["received"], run["buses"]["main"]["written"])
    for rows in lists:
        at = next(i for i, (_, text) in enumerate(rows) if text == old)
        rows[at : at + 1] = [] if new is None else [[rows[at][0], new]]


def add(run, servo_id, at_s, text):
    servo(run, servo_id)["received"].append([at_s, text])
    servo(run, servo_id)["received"].sort()
    run["buses"]["main"]["written"].append([at_s - 0.002, text])
    run["buses"]["main"]["written"].sort()


def rules(run, robot=ROBOT):
    return {one.rule for one in objections(recording_of(robot, run))}


def texts(run):
    return [str(one) for one in objections(recording_of(ROBOT, run))]


def test_a_good_run_has_no_objection():
    assert texts(record()) == []


def test_the_judge_imports_nothing_of_the_project():
    for path in (TOOLS / "judge").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [
                n for n in names if n.split(".")[0] in {"lss_motion", "campaign", "benches"}
            ]


@pytest.mark.parametrize(
    ("servo_id", "old", "new", "rule"),
    [
        (1, "#1D-300T1000\r", "#1D-510T2000\r", "range"),  # Joint angle 61.
        (1, "#1D-300T1000\r", "#1D710T2000\r", "range"),  # Joint angle -61.
        (1, "#1D-300T1000\r", "#1D-502T2000\r", "range"),  # 0.2 deg out.
        (1, "#1D-300T1000\r", "#1P800\r", "range"),  # -63 deg of the servo: 73 of the joint.
        (1, "#1D-300T1000\r", "#1MD-800T2000\r", "range"),
        (1, "#1D-300T1000\r", "#1WD300\r", "range"),  # It turns without end.
        (2, "#2D3000T1000\r", "#2D6100T2000\r", "range"),  # Hundredths.
        (209, "#209D230\r", "#209D650\r", "range"),
        (1, "#1SD1000\r", "#1SD1100\r", "settings"),
        (1, "#1SD1000\r", None, "settings"),
        (1, "#1AA40\r", "#1AA41\r", "settings"),
        (1, "#1AD40\r", None, "settings"),
        (2, "#2SD10000\r", "#2SD100000\r", "settings"),  # Ten times too fast in one reading.
        (2, "#2AA40000\r", None, "settings"),
        (1, "#1EM1\r", "#1EM0\r", "speed"),  # T does not count in EM0: it jumps.
        (3, "#3EM0\r", None, "settings"),  # A bare D in EM1 with the factory's ramps.
        (3, "#3D384\r", "#3D590\r", "speed"),
        (209, "#209D230\r", "#209D500\r", "speed"),
        (1, "#1AA40\r", "#1G-1\r", "frame"),
        (1, "#1AA40\r", "#1O50\r", "frame"),
        (1, "#1H\r", None, "end"),
        (2, "#2H\r", None, "end"),
        (3, "#3H\r", "#3D100\r", "end"),
    ],
)
def test_a_wrong_command_is_objected_to(servo_id, old, new, rule):
    run = record()
    swap(run, servo_id, old, new)
    if rule == "settings" and servo_id == 3:
        swap(run, 3, "#3SD1000\r", None)
    assert rule in rules(run)


def test_a_move_faster_than_the_limit_is_objected_to_where_sd_does_not_hold_it():
    run = record()
    swap(run, 1, "#1SD1000\r", "#1SD3000\r")
    assert "speed" not in rules(run)
    swap(run, 1, "#1D-300T1000\r", "#1D-300T200\r")
    assert "speed" in rules(run)


def test_a_speed_that_rides_with_the_move_counts():
    run = record()
    swap(run, 1, "#1SD1000\r", None)
    swap(run, 1, "#1D-300T1000\r", "#1D-9T100SD999\r")
    assert rules(run) == set()


@pytest.mark.parametrize("how", ["fault", "command"])
def test_a_restarted_servo_that_gets_a_move_before_its_settings_is_objected_to(how):
    run = record()
    if how == "fault":
        servo(run, 1)["restarts"] = [0.3]
    else:
        add(run, 1, 0.3, "#1RESET\r")
    assert rules(run) == {"settings"}
    assert "it restarted at 0.300 s" in texts(run)[0]
    for at_s, text in ((1.8, "#1SD1000\r"), (1.82, "#1AA40\r"), (1.84, "#1AD40\r")):
        add(run, 1, at_s, text)
    assert rules(run) == set()


def test_a_restart_that_no_host_can_know_of_yet_excuses_ramps_but_no_speed():
    run = record()
    servo(run, 1)["restarts"] = [1.9]
    assert rules(run) == set()
    swap(run, 1, "#1D-300T1000\r", "#1D-300T200\r")
    assert "speed" in rules(run)


def test_a_move_that_was_on_its_way_when_its_servo_restarted_is_not_objected_to():
    run = record()
    swap(run, 1, "#1D-300T1000\r", "#1D-300T200\r")
    servo(run, 1)["restarts"] = [1.999]  # Written at 1.998 s, received at 2 s.
    assert "speed" not in rules(run)
    servo(run, 1)["restarts"] = [1.997]
    assert "speed" in rules(run)


def test_stored_limits_are_what_a_restarted_servo_has():
    run = record()
    servo(run, 1)["restarts"] = [0.3]
    servo(run, 1)["stored"] = {"SD": 1000, "AA": 40, "AD": 40}
    assert rules(run) == set()


def test_settings_that_something_else_changed_are_in_force():
    run = record()
    servo(run, 1)["changes"] = [[1.0, {"SD": 3600}]]
    assert rules(run) == {"settings"}
    servo(run, 1)["changes"] = [[0.0, {"SD": 3600}]]  # The host sets it after that.
    assert rules(run) == set()


def test_a_wrong_frame_of_the_servo_is_objected_to_unless_the_file_has_it():
    run = record()
    servo(run, 1)["stored"] = {"G": -1}
    assert "frame" in rules(run)
    robot = copy.deepcopy(ROBOT)
    robot["joints"]["timed"]["stored"] = {"G": -1}
    assert "frame" not in rules(run, robot)


@pytest.mark.parametrize("garbled", ["#209o-700", "#209SD1", "#209EM0", "#209AR-9000"])
def test_a_board_has_no_settings_of_servos(garbled):
    """Another host, or a garbled `#209D-700`, writes what a 2IO does not know."""
    run = record()
    servo(run, 209)["received"].insert(4, [2.05, f"{garbled}\r"])
    assert rules(run) == set()


def test_leading_a_horn_back_into_its_range_is_allowed_and_leading_it_further_out_is_not():
    run = record()
    servo(run, 3)["horn_deg"] = trapezoid(2.0, 63.0, 30.0, 20.0, 400.0)
    rows = [[0.4, "#3D630\r"], [0.42, "#3D627\r"], [0.44, "#3D624\r"]]
    for at_s, text in rows:
        add(run, 3, at_s, text)
    assert "range" not in rules(run)
    add(run, 3, 0.46, "#3D645\r")
    assert "range" in rules(run)


def test_what_the_host_did_not_write_is_not_its_fault():
    run = record()
    servo(run, 1)["received"].insert(4, [1.5, "#1D9000T100\r"])
    assert rules(run) == set()


def test_a_flood_is_objected_to():
    run = record()
    rows = [[3.5, "#1D-300T1000\r"] for _ in range(40)]
    run["buses"]["main"]["written"] += rows
    run["buses"]["main"]["written"].sort()
    servo(run, 1)["received"] += [[3.5 + 0.001 * i, text] for i, (_, text) in enumerate(rows)]
    servo(run, 1)["received"].sort()
    assert rules(run) == {"flood"}


def test_more_bytes_than_the_line_carries_are_objected_to():
    run = record()
    run["buses"]["main"]["written"] += [[3.0 + 0.0001 * i, "#1QD\r"] for i in range(1500)]
    run["buses"]["main"]["written"].sort()
    assert "flood" in rules(run)


def test_a_section_that_overruns_the_buffer_of_a_2io_is_objected_to():
    run = record()
    swap(run, 1, "#1D-300T1000\r", "#1D-300T1000SD900\r")
    assert "board" in rules(run)


def test_a_port_that_is_gone_at_the_end_takes_no_last_bytes():
    run = record()
    swap(run, 1, "#1H\r", None)
    run["buses"]["main"]["gone"] = [[4.5, 99.0]]
    assert rules(run) == set()


@pytest.mark.parametrize(
    ("horn", "rule"),
    [
        (trapezoid(2.0, 10.0, -30.0, 110.0, 400.0), "horn speed"),
        (trapezoid(2.0, 10.0, -30.0, 40.0, 500.0), "horn acceleration"),
        (trapezoid(2.0, 10.0, -51.0, 40.0, 400.0), "horn range"),
        (trapezoid(4.0, 10.0, -30.0, 15.0, 400.0), "end"),  # It still moves.
    ],
)
def test_a_horn_beyond_its_limits_is_objected_to(horn, rule):
    run = record()
    servo(run, 1)["horn_deg"] = horn
    assert rule in rules(run)
    servo(run, 1)["excuse"] = "weak"
    assert rules(run) == set()


def test_a_halt_at_the_end_may_stop_a_horn_at_once_and_one_before_a_move_may_not():
    run = record()
    gone = trapezoid(2.0, 10.0, -30.0, 20.0, 400.0)
    servo(run, 1)["horn_deg"] = [gone[min(i, 500)] for i in range(1200)]
    assert rules(run) == {"horn acceleration"}
    swap(run, 1, "#1H\r", None)
    add(run, 1, 2.49, "#1H\r")
    assert rules(run) == set()
    add(run, 1, 3.0, "#1D-190T1000\r")
    add(run, 1, 5.0, "#1H\r")
    assert rules(run) == {"horn acceleration"}


def test_a_joint_that_was_told_nothing_may_stand_anywhere():
    run = record()
    for one in run["servos"]:
        one["received"] = []
    run["buses"]["main"]["written"] = []
    servo(run, 1)["horn_deg"] = [100.0] * 1200
    for servo_id in (2, 3):
        servo(run, servo_id)["horn_deg"] = []
    assert rules(run) == set()


def test_a_file_can_be_judged(tmp_path):
    run = record()
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(ROBOT))
    judge = [sys.executable, TOOLS / "judge", tmp_path / "robot.yaml", tmp_path / "run.json"]
    (tmp_path / "run.json").write_text(json.dumps(run))
    good = subprocess.run(judge, capture_output=True, text=True, check=False)
    assert (good.returncode, good.stdout) == (0, "0 objections\n")
    swap(run, 1, "#1SD1000\r", None)
    (tmp_path / "run.json").write_text(json.dumps(run))
    bad = subprocess.run(judge, capture_output=True, text=True, check=False)
    assert bad.returncode == 1
    assert "settings: timed at 2.000 s" in bad.stdout
