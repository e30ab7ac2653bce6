"""The sketch, compiled for this computer with a stand-in for the library, sends the right bytes.

The stand-in has the interface of the maker's library (LSS.h) as far as the sketch uses it: it
writes what `genericWrite` is documented to write. Its clock advances when it is read.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.planning import shows
from lss_motion.planning.program.arduino import sketch
from lss_motion.planning.program.model import Repeat
from lss_motion.planning.program.text import load_program
from lss_motion.playing.player.handshake import session_commands
from lss_motion.playing.run import perform
from lss_motion.robot.load import load_robot
from lss_motion.show.model import Cue
from lss_motion.sim.bus import bus_from_robot
from tests.unit.robot.test_mechanisms import HEAD, eyes_csv

if TYPE_CHECKING:
    from pathlib import Path

HORNS_DEG = 0.5
"""Two runs begin at other phases of the servos' 5 ms loops: at 60 deg/s that is 0.3 deg. Measured:
at most 0.23 deg."""

needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not here")

ARDUINO_H = r"""
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>
#define PROGMEM
#define memcpy_P memcpy
#define LOW 0
#define INPUT_PULLUP 2
struct HardwareSerial {};
extern HardwareSerial Serial;
uint32_t micros();
uint32_t millis();
void delay(uint32_t ms);
void pinMode(int pin, int mode);
int digitalRead(int pin);
"""

LSS_H = r"""
#pragma once
#include "Arduino.h"
enum LSS_LastCommStatus { LSS_CommStatus_ReadSuccess, LSS_CommStatus_ReadTimeout };
#define LSS_QueryPosition ("QD")
#define LSS_ActionMove ("D")
#define LSS_ActionParameterTime ("T")
#define LSS_ActionHold ("H")
#define LSS_ActionLimp ("L")
#define LSS_ActionColorLED ("LED")
class LSS {
 public:
  explicit LSS(uint8_t id);
  static void initBus(HardwareSerial &port, uint32_t baud);
  static bool genericWrite(uint8_t id, const char *cmd);
  static bool genericWrite(uint8_t id, const char *cmd, int16_t value);
  static bool genericWrite(uint8_t id, const char *cmd, int16_t value, const char *parameter,
                           int16_t parameter_value);
  static int16_t genericRead_Blocking_s16(uint8_t id, const char *cmd);
  LSS_LastCommStatus getLastCommStatus();
};
"""

MAIN = r"""
#include "LSS.h"
#include SKETCH
HardwareSerial Serial;
static uint64_t now_us = START_US;
static LSS_LastCommStatus status;
uint32_t micros() { return (uint32_t)(now_us += 20); }
uint32_t millis() { return (uint32_t)((now_us += 20) / 1000); }
void delay(uint32_t ms) { now_us += 1000ULL * ms; }
void pinMode(int, int) {}
int digitalRead(int) { return now_us >= STOP_US ? LOW : 1; }
LSS::LSS(uint8_t) {}
void LSS::initBus(HardwareSerial &, uint32_t baud) { std::printf("baud %u\n", baud); }
static void stamp() { std::printf("%llu ", (unsigned long long)(now_us - START_US)); }
bool LSS::genericWrite(uint8_t id, const char *cmd) {
  stamp();
  std::printf("#%u%s\n", id, cmd);
  return true;
}
bool LSS::genericWrite(uint8_t id, const char *cmd, int16_t value) {
  stamp();
  std::printf("#%u%s%d\n", id, cmd, value);
  return true;
}
bool LSS::genericWrite(uint8_t id, const char *cmd, int16_t value, const char *parameter,
                       int16_t parameter_value) {
  stamp();
  std::printf("#%u%s%d%s%d\n", id, cmd, value, parameter, parameter_value);
  return true;
}
int16_t LSS::genericRead_Blocking_s16(uint8_t id, const char *) {
  status = id == SILENT_ID ? LSS_CommStatus_ReadTimeout : LSS_CommStatus_ReadSuccess;
  return STANDS;
}
LSS_LastCommStatus LSS::getLastCommStatus() { return status; }
int main() {
  setup();
  while (now_us - START_US < RUN_US) {
    now_us += 20;
    loop();
  }
}
"""

ROBOT = """\
robot: two
end: limp
approach_speed_deg_s: 20
defaults: {model: LSS-ST1, range_deg: [-170, 170], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1, settings: {AS: -2}}
  tilt: {id: 2, direction: -1, zero_deg: 5}
"""
SHOW = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {pan: 30, tilt: 0}}
  - {at_s: 1, deg: {pan: -30, tilt: 20}}
  - {at_s: 1.5, deg: {tilt: -20}}
  - {at_s: 3, deg: {pan: 30, tilt: 0}}
events:
  - {at_s: 0.5, led: {pan: red}}
  - {at_s: 1, say: hello}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    (tmp_path / "show.yaml").write_text(SHOW, encoding="utf-8")
    (tmp_path / "fake").mkdir()
    (tmp_path / "fake" / "Arduino.h").write_text(ARDUINO_H, encoding="utf-8")
    (tmp_path / "fake" / "LSS.h").write_text(LSS_H, encoding="utf-8")
    (tmp_path / "fake" / "main.cpp").write_text(MAIN, encoding="utf-8")
    return tmp_path


def run(folder: Path, ino: Path, **scene: int) -> list[tuple[int, str]]:
    """Compile and run the sketch; return instants in us and commands."""
    given = {"START_US": 0, "STOP_US": 10**12, "SILENT_ID": 250, "STANDS": 0, "RUN_US": 15_000_000}
    words = [
        f"-D{name}={value}ULL" for name, value in {**given, **scene}.items() if name != "STANDS"
    ]
    words += [f"-DSTANDS={scene.get('STANDS', 0)}", f'-DSKETCH="{ino}"']
    flags = ["-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined"]
    fake = folder / "fake"
    command = ["g++", *flags, f"-I{fake}", f"-I{folder}", *words, str(fake / "main.cpp")]
    subprocess.run([*command, "-o", str(fake / "play")], check=True)
    done = subprocess.run([str(fake / "play")], check=True, capture_output=True, text=True)
    assert done.stderr == ""
    first, *lines = done.stdout.splitlines()
    assert first == "baud 115200"
    return [(int(line.split()[0]), line.split()[1]) for line in lines]


@needs_compiler
def test_the_sketch_sends_the_bytes_of_the_program_at_their_instants(folder, capsys) -> None:
    ino, lss = folder / "nod.ino", folder / "nod.lss"
    assert main(["export", str(folder / "show.yaml"), "-o", str(ino)]) == 0
    assert "Not carried over: say: 'hello'" in capsys.readouterr().out
    assert main(["export", str(folder / "show.yaml"), "-o", str(lss)]) == 0
    program, robot = load_program(lss, load_robot)
    assert program.moves[0].due_us > -1_000_000
    sent = run(folder, ino)
    settings = [
        f"#{c.servo_id}{c.keyword}{c.value}" for c in session_commands(robot.joints.values())
    ]
    assert "#1AS-2" in settings
    assert [text for _, text in sent[: len(settings)]] == settings
    rest = sent[len(settings) :]
    # pan goes 30 degrees at 20 deg/s; all take as long.
    assert [text for _, text in rest[:2]] == ["#1D300T1501", "#2D50T1501"]
    assert [text for _, text in rest[-2:]] == ["#1L", "#2L"]
    shown = rest[2:-2]
    expected = [(move.due_us, move.data.decode().strip()) for move in program.moves]
    expected = sorted([*expected, (500_000, "#1LED1")], key=lambda order: order[0])
    assert [text for _, text in shown] == [text for _, text in expected]
    start_us = shown[0][0] - expected[0][0]
    assert start_us - rest[0][0] >= 1_501_000
    for (at_us, text), (due_us, _) in zip(shown, expected, strict=True):
        assert 0 <= at_us - start_us - due_us + 50 < 400, text
    assert abs(rest[-1][0] - start_us - 1e6 * program.duration_s) < 400


@pytest.mark.slow
@needs_compiler
def test_the_horns_do_by_the_sketch_what_they_do_by_lss_play(folder) -> None:
    """The bytes of the compiled sketch go to the simulated servos at the instants it sent them."""
    ino, lss = folder / "nod.ino", folder / "nod.lss"
    for output in (ino, lss):
        assert main(["export", str(folder / "show.yaml"), "-o", str(output)]) == 0
    program, robot = load_program(lss, load_robot)
    sent = run(folder, ino)
    bus = bus_from_robot(robot, "main", start_deg={"pan": 0.0, "tilt": 5.0})
    bus.record()
    for at_us, text in sent:
        bus.write(f"{text}\r".encode(), 1000 * at_us)
    bus.advance(10**9 + 1000 * sent[-1][0])
    first_us = next(at_us for at_us, text in sent if text == program.moves[0].data.decode().strip())
    truth = perform(program, robot, is_virtual=True, has_feedback=False).truth
    in_show = (truth.times_s > 0.1) & (truth.times_s < program.duration_s)
    times_s = truth.times_s[in_show]
    instants_ns = 1e3 * (first_us - program.moves[0].due_us) + 1e9 * times_s
    servo_deg = bus.horn_deg(instants_ns.astype(np.int64).tolist())
    joints = [robot.joints[name] for name in truth.joints]
    by_id = {joint.servo_id: column for column, joint in enumerate(robot.joints.values())}
    for column, joint in enumerate(joints):
        own_deg = [joint.joint_deg(deg) for deg in servo_deg[:, by_id[joint.servo_id]].tolist()]
        played_deg = truth.horn_deg[in_show, column]
        assert np.ptp(played_deg) > 30.0
        np.testing.assert_allclose(own_deg, played_deg, atol=HORNS_DEG)


@needs_compiler
def test_the_sketch_of_a_robot_with_mechanisms_moves_its_servos(folder) -> None:
    """Gears, linkages, a differential, a pair and a table are moves of servos in the sketch."""
    (folder / "eyes.csv").write_text(eyes_csv(), encoding="utf-8")
    (folder / "robot.yaml").write_text(HEAD, encoding="utf-8")
    joints = ["turret", "jaw", "lid", "tilt", "roll", "arm", "yaw", "pitch"]
    there = dict(zip(joints, (30, 22, 50, 20, 10, 60, 25, -15), strict=True))
    frames = [
        {"at_s": 0, "deg": dict.fromkeys(joints, 0)},
        {"at_s": 1, "deg": there},
        {"at_s": 2.4, "deg": dict.fromkeys(joints, 0)},
    ]
    show = {"sequence": "nod", "robot": "robot.yaml", "keyframes": frames}
    (folder / "show.yaml").write_text(json.dumps(show), encoding="utf-8")
    ino = folder / "nod.ino"
    assert main(["export", str(folder / "show.yaml"), "-o", str(ino)]) == 0
    sent = run(folder, ino)
    made = shows.prepare(folder / "show.yaml", None)
    program, robot = made.program, made.robot
    shown = [text for _, text in sent if "T" in text][len(robot.servos) :]
    assert shown == [move.data.decode().strip() for move in program.moves]
    bus = bus_from_robot(robot.servo_robot, "main")
    bus.record()
    for at_us, text in sent:
        bus.write(f"{text}\r".encode(), 1000 * at_us)
    bus.advance(10**9 + 1000 * sent[-1][0])
    first = program.moves[0]
    first_us = next(at_us for at_us, text in sent if text == first.data.decode().strip())
    truth = perform(program, robot, is_virtual=True, has_feedback=False).truth
    times_s = truth.times_s[(truth.times_s > 0.1) & (truth.times_s < program.duration_s)]
    instants_ns = 1e3 * (first_us - first.due_us) + 1e9 * times_s
    servo_deg = bus.horn_deg(instants_ns.astype(np.int64).tolist())
    for column, servo in enumerate(robot.servos.values()):
        played_deg = truth.horn_deg[:, truth.joints.index(f"servo:{servo.name}")]
        own_deg = np.array([servo.joint_deg(deg) for deg in servo_deg[:, column].tolist()])
        assert np.ptp(own_deg) > 10.0, servo.name
        played_deg = np.interp(times_s, truth.times_s, played_deg)
        assert np.abs(own_deg - played_deg).max() < 2.0 * HORNS_DEG, servo.name


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    ("scene", "last"),
    [
        ({"SILENT_ID": 2}, []),
        ({"STANDS": -1700}, ["#1L", "#2L"]),
        ({"START_US": 2**32 - 4_000_000}, ["#1L", "#2L"]),
    ],
)
def test_it_plays_only_if_all_answer_and_from_anywhere_at_any_clock(folder, scene, last) -> None:
    ino = folder / "nod.ino"
    assert main(["export", str(folder / "show.yaml"), "-o", str(ino)]) == 0
    sent = run(folder, ino, **scene, RUN_US=30_000_000)
    assert [text for _, text in sent[-2:]] == last
    if "STANDS" in scene:
        assert "#1D300T10001" in [text for _, text in sent]


@pytest.mark.slow
@needs_compiler
def test_the_button_holds_all_servos(folder) -> None:
    ino = folder / "nod.ino"
    assert main(["export", str(folder / "show.yaml"), "-o", str(ino)]) == 0
    text = ino.read_text(encoding="utf-8")
    ino.write_text(text.replace("STOP_PIN = -1", "STOP_PIN = 4"), encoding="utf-8")
    for stop_us in (2_500_000, 5_000_000):
        sent = run(folder, ino, STOP_US=stop_us)
        assert [text for _, text in sent[-2:]] == ["#1H", "#2H"]
        assert sent[-1][0] - stop_us < 400


@pytest.mark.slow
@needs_compiler
def test_an_endless_program_repeats(folder) -> None:
    lss = folder / "nod.lss"
    assert main(["export", str(folder / "show.yaml"), "-o", str(lss)]) == 0
    once, robot = load_program(lss, load_robot)
    program = replace(
        once,
        moves=once.moves,
        duration_s=float("inf"),
        repeat=Repeat(from_us=1_000_000, to_us=3_000_000),
    )
    ino = folder / "loop.ino"
    settings = session_commands(robot.joints.values())
    made = sketch(program, robot, settings, ino)
    ino.write_text(made.sketch, encoding="utf-8")
    (folder / "loop_program.h").write_text(made.header, encoding="utf-8")
    sent = [(at, text) for at, text in run(folder, ino)[len(settings) + 2 :] if "LED" not in text]
    expected = [
        (due_us, move.data.decode().strip())
        for (due_us, move), _ in zip(program.unrolled(), sent, strict=False)
    ]
    assert [text for _, text in sent] == [text for _, text in expected]
    assert len(sent) > 2 * len(program.moves)
    start_us = sent[0][0] - expected[0][0]
    for (at_us, text), (due_us, _) in zip(sent, expected, strict=True):
        assert 0 <= at_us - start_us - due_us + 50 < 400, text


def test_what_a_sketch_cannot_play_is_refused(folder) -> None:
    lss = folder / "nod.lss"
    assert main(["export", str(folder / "show.yaml"), "-o", str(lss)]) == 0
    program, robot = load_program(lss, load_robot)
    path = folder / "nod.ino"

    def refused(program, robot=robot, path=path) -> str:
        with pytest.raises(InputError) as caught:
            sketch(program, robot, [], path)
        return str(caught.value)

    assert "letters, digits, _ and -" in refused(program, path=folder / "my show.ino")
    assert "at most 4000 s" in refused(replace(program, duration_s=5000.0))
    moves = [replace_target(move, 40_000) for move in program.moves]
    assert "takes numbers up to 32767" in refused(replace(program, moves=tuple(moves)))
    pro = replace(robot.joints["pan"], bus="other")
    other = replace(robot, joints={**robot.joints, "pan": pro})
    assert "one bus only" in refused(program, robot=other)
    left = replace(program, cues=(Cue(at_s=0.0, sound="a\nb.wav"),))
    assert (
        "Not carried over: sound: 'a\\\\nb.wav'".replace("\\\\", "?")
        in sketch(left, robot, [], path).header
    )


def test_a_program_that_no_8_bit_board_can_hold_says_so(folder) -> None:
    lss = folder / "nod.lss"
    assert main(["export", str(folder / "show.yaml"), "-o", str(lss)]) == 0
    program, robot = load_program(lss, load_robot)
    small = sketch(program, robot, [], folder / "nod.ino")
    assert "#error" not in small.header
    assert small.notes == ()
    many = tuple(program.moves) * (32_767 // 10 // len(program.moves) + 1)
    large = sketch(replace(program, moves=many), robot, [], folder / "nod.ino")
    assert "#ifdef __AVR__\n#error " in large.header
    assert "an 8-bit board (Uno, Nano, Mega) takes 32767" in large.notes[0]


def replace_target(move, target_wire: int):
    return move._replace(target_wire=target_wire)
