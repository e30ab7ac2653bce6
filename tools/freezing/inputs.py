"""Robot files, shows, fault plans and foreign files that the frozen cases use.

They belong to the cases, not to the examples: they must not change while two versions of the code
are compared.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

ARM: Final = """\
robot: arm
buses:
  main: {port: "sim://", baud_bps: BAUD, firmware: FIRMWARE}
defaults: {model: MODEL, speed_max_deg_s: 180, accel_max_deg_s2: 600MORE}
joints:
  base: {id: 1, range_deg: [-170, 170]}
  shoulder: {id: 2, range_deg: [-90, 90], direction: -1, zero_deg: 3.5}
  elbow: {id: 3, range_deg: [-110, 90]}
  gripper: {id: 5, range_deg: [0, 60], following_deg: 20}
groups: {reach: [shoulder, elbow]}
poses:
  home: {base: 0, shoulder: 45, elbow: -60, gripper: 10}
"""
LADDERS: Final = """\
on_fault: {silent: [warn, resume, hold], restarted: [resume, hold], astray: [slow, warn],
           stuck: [warn, hold], hot: [slow, hold], lost_port: [resume, hold]}
patience_s: 0.4
resume_s: 2
"""
MIXED: Final = """\
robot: mixed
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
  pro: {port: "sim://", baud_bps: 57600}
defaults: {model: LSS-ST1, bus: main, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1, range_deg: [-120, 120], settings: {AS: -2, AH: 3}}
  wing: {id: 2, range_deg: [0, 70], drive: streamed, direction: -1, speed_max_deg_s: 240,
         accel_max_deg_s2: 1500}
  auto: {id: 3, range_deg: [-90, 90], drive: auto, zero_deg: -2.5}
  lid: {id: 209, model: LSS-2IO, range_deg: [0, 60], speed_max_deg_s: 350, accel_max_deg_s2: 3000}
  slide: {id: 1, bus: pro, model: LSS-P-S1, range_deg: [-90, 90]}
  turn: {id: 2, bus: pro, model: LSS-P-M1, range_deg: [-90, 90], direction: -1}
sensors:
  eye: {id: 203, bus: main, kind: GP2Y0A21YK0F}
poses:
  rest: {pan: 0, wing: 0, auto: 0, lid: 0, slide: 0, turn: 0}
end: limp
"""
ROBOTS: Final = {
    "timed": ARM,
    "streamed": ARM.replace("MORE", ", drive: streamed"),
    "old": ARM.replace("BAUD", "38400").replace("FIRMWARE", "368"),
    "pro": ARM.replace("MODEL", "LSS-P-S1"),
    "ladders": ARM + LADDERS,
    "mixed": MIXED,
}
"""By name. Words in capitals that are left get the values of the timed arm."""

ARM_SHOW: Final = """\
sequence: short
robot: ROBOT.yaml
keyframes:
  - {at_s: 0.0, pose: home, label: start}
  - {at_s: 0.7, deg: {base: 25, shoulder: 20}, label: there}
  - {at_s: 1.2, deg: {elbow: -50, gripper: 40}, ease: linear}
  - {after_s: 0.5, deg: {base: -10, elbow: -65}, ease: spline, hold_s: 0.1}
  - {at_s: 2.4, pose: home, anchor: true}
events:
  - {at_s: 0.3, led: {base: red, elbow: blue}}
  - {at_s: 1.0, say: halfway}
"""
MIXED_SHOW: Final = """\
sequence: short
robot: ROBOT.yaml
keyframes:
  - {at_s: 0.0, pose: rest}
  - {at_s: 0.6, deg: {pan: 40, slide: 30, lid: 45}, label: there}
  - {at_s: 0.9, deg: {wing: 45, turn: -35, auto: 30}}
  - {at_s: 1.3, deg: {wing: 5, lid: 0, pan: -20}}
  - {at_s: 2.4, pose: rest}
"""
SHOWS: Final = {name: MIXED_SHOW if name == "mixed" else ARM_SHOW for name in ROBOTS}
WAIT_SHOW: Final = """\
sequence: waits
robot: mixed.yaml
play:
  - {wait_for: {sensor: eye, below_mm: 500}, timeout_s: 1.5}
  - {file: mixed_show.yaml, speed_ratio: 0.8}
  - {pause_s: 0.2}
"""
TOO_FAST: Final = """\
sequence: too fast
robot: timed.yaml
keyframes:
  - {at_s: 0.0, pose: home}
  - {at_s: 0.2, deg: {base: 60, gripper: 50}, label: too soon}
  - {at_s: 1.0, deg: {base: -60}, ANCHOR}
  - {at_s: 1.3, pose: home}
"""
WRONG: Final = """\
sequence: wrong
robot: timed.yaml
keyframes:
  - {at_s: 0.0, pose: hoem}
  - {at_s: 0.2, deg: {bass: 60, gripper: 90}}
  - {at_s: 0.1, dge: {base: -60}}
"""
CONFIGURE: Final = """\
robot: stored
buses: {main: {port: "sim://"}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  a: {id: 4, stored: {LED: 3, AS: -2, FPC: 7}}
  b: {id: 9, stored: {O: 2.5, G: -1}, settings: {AH: 3}}
"""
FAULTS: Final = {
    "lost_command": "{kind: lost_command, at_s: 0.2, ratio: 0.1}",
    "corrupt_command": "{kind: corrupt_command, at_s: 0.2, ratio: 0.1}",
    "short_command": "{kind: short_command, at_s: 0.2, ratio: 0.1}",
    "double_command": "{kind: double_command, at_s: 0.2, ratio: 0.1}",
    "merged_command": "{kind: merged_command, at_s: 0.2, ratio: 0.1}",
    "lost_reply": "{kind: lost_reply, ratio: 0.2}",
    "corrupt_reply": "{kind: corrupt_reply, ratio: 0.2}",
    "short_reply": "{kind: short_reply, ratio: 0.2}",
    "double_reply": "{kind: double_reply, ratio: 0.2}",
    "merged_reply": "{kind: merged_reply, ratio: 0.2}",
    "late_reply": "{kind: late_reply, late_s: 0.03, ratio: 0.1}",
    "split_reply": "{kind: split_reply, late_s: 0.01, ratio: 0.2}",
    "clogged": "{kind: clogged, at_s: 2.0, until_s: 2.3}",
    "unplugged": "{kind: unplugged, at_s: 2.0, until_s: 2.8}",
    "gone": "{kind: unplugged, at_s: 2.0}",
    "oversleep": "{kind: oversleep, late_s: 0.04, ratio: 0.02}",
    "clock_drift": "{kind: clock_drift, drift_ppm: 5000}",
    "deaf": "{kind: deaf, servo: 1, at_s: 2.0, until_s: 2.5}",
    "wrong_id": "{kind: wrong_id, servo: 1, as_id: 2, at_s: 1.5, ratio: 0.3}",
    "reset": "{kind: reset, servo: 2, at_s: 2.2}",
    "stuck": "{kind: stuck, servo: 1, at_s: 1.8, until_s: 2.8}",
    "weak": "{kind: weak, servo: 1, speed_ratio: 0.3}",
    "hot": "{kind: hot, servo: 2, temperature_c: 85, at_s: 1.5}",
    "many": "{kind: lost_reply, ratio: 0.1}, {kind: corrupt_command, at_s: 0.5, ratio: 0.05}, "
    "{kind: reset, servo: 1, at_s: 2.0}, {kind: oversleep, late_s: 0.02, ratio: 0.05}",
}
"""Fault plans for the short shows, by name."""
INPUT_FAULT: Final = "{kind: input, servo: 203, at_s: 1.9, distance_mm: 300, sensor: GP2Y0A21YK0F}"

HALL: Final[dict[str, str]] = {
    "puppet.yaml": """\
robot: puppet
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  neck: {id: 1, range_deg: [-90, 90]}
  jaw:  {id: 2, range_deg: [-90, 90], drive: streamed}
  lid:  {id: 3, range_deg: [-90, 90]}
sensors: {door: {id: 203, kind: GP2Y0A21YK0F}}
on_fault: {silent: [warn, resume, hold]}
""",
    **{
        f"hall_{name}.yaml": f"sequence: {name}\nrobot: puppet.yaml\nkeyframes:\n"
        + "".join(f"  - {{at_s: {at}, deg: {deg}}}\n" for at, deg in enumerate(poses))
        for name, poses in {
            "idle": ("{neck: 0}", "{neck: 10}", "{neck: 0}"),
            "scare": ("{neck: 0, jaw: 0}", "{neck: 30, jaw: 40}", "{neck: 0, jaw: 0}"),
            "wink": ("{lid: 0}", "{lid: 20}", "{lid: 0}"),
            "sleep": ("{neck: 0, jaw: 0}", "{neck: -30, jaw: 0}"),
        }.items()
    },
    "hall.yaml": """\
stage: hall
robot: puppet.yaml
shows: {idle: hall_idle.yaml, scare: hall_scare.yaml, wink: hall_wink.yaml, sleep: hall_sleep.yaml}
idle: idle
cues:
  - {cue: visitor, on: {sensor: door, below_mm: 500}, play: scare, cooldown_s: 5}
  - {cue: hi, on: {key: h}, play: scare, start: queue}
  - {cue: loud, on: {osc: /scare}, play: scare, start: interrupt, priority: 1}
  - {cue: winks, on: {key: w}, play: wink, start: add}
  - {cue: some, on: {key: x}, play: [scare, wink], choose: random, start: terminate}
  - {cue: next, on: {go: true}, play: wink, start: terminate}
  - {cue: late, on: {http: late}, play: scare, enabled: false}
  - {cue: minute, on: {time: "* * * * *"}, play: wink, start: add}
duty: {rest: sleep, limp: true}
on_fault: {wait_s: 4, total: 3}
listen: {osc: "127.0.0.1:9000", http: "127.0.0.1:8440"}
log: {folder: hall_log}
""",
    "hall_visitor.yaml": "faults:\n"
    "  - {kind: input, servo: 203, at_s: 6.0, distance_mm: 300, sensor: GP2Y0A21YK0F}\n"
    "  - {kind: input, servo: 203, at_s: 20.0, distance_mm: 700, sensor: GP2Y0A21YK0F}\n",
    "hall_deaf.yaml": "faults:\n  - {kind: deaf, servo: 1, at_s: 18.0}\n",
    "by_hand.csv": "t_s,base,shoulder,elbow,gripper\n"
    "0,0,0,0,0\n3,10,20,-15,12\n6,10,20,-15,12\n8,30,20,-15,12\n10,30,45,-15,12\n"
    "12,30,45,10,5\n14,30,45,10,5\n16,30,45,10,5\n",
}
"""A stage with every way to start a show, faults for it, and a hand that moves the timed arm."""

MISTAKES: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "robot": (
        "check", "timed_show.yaml",
        ("ST1 -> ST9", "id: 2 -> id: 1", "id: 3 -> id: 300", "[0, 60] -> [60, 0]",
         "[0, 60] -> [0, sixty]", "180, accel -> -180, accel", "180 -> 1800", "600 -> fast",
         "115200 -> 115201", "firmware: 370 -> firmware: 1", "port: -> prot:", "\"sim://\" -> \"\"",
         "direction: -1 -> direction: 2", "range_deg: [-170, 170] -> rang_deg: [-170, 170]",
         ", range_deg: [-90, 90] ->", "base: 0, -> bass: 0,", "gripper: 10 -> gripper: 100",
         "[shoulder, elbow] -> [shoulder, ellbow]", "robot: arm -> robot:", "joints: -> jonts:",
         "  base: -> \tbase:", "elbow: { -> base: {", "{id: 1 -> {id: 1, drive: stream",
         "{id: 1 -> {id: 1, bus: none", "{id: 1 -> {id: 1, settings: {AS: 900}",
         "{id: 1 -> {id: 1, stored: {ZZ: 1}", "{id: 1 -> {id: yes", "poses: -> poses: 5 #",
         "groups: {reach -> groups: {base", "robot: arm -> robot: arm\nend: fall",
         "robot: arm -> robot: arm\non_fault: {silent: [hold, warn]}",
         "robot: arm -> robot: arm\non_fault: {silnt: [warn]}", "robot: arm -> - robot: arm",
         "robot: arm -> robot: arm\npatience_s: 0"),
    ),
    "sequence": (
        "check", "timed_show.yaml",
        ("home, label -> hom, label", "at_s: 0.7 -> at_s: -1", "at_s: 1.2 -> at_s: 0.1",
         "at_s: 2.4 -> after_s: 0.1, at_s: 2.4", "base: 25 -> base: 250", "base: 25 -> bse: 25",
         "base: 25 -> base: left", "ease: linear -> ease: liner", "label: there -> label: start",
         "led: -> lde:", "base: red -> base: pink", "keyframes: -> keyframe:",
         "robot: timed.yaml -> robot: none.yaml", "sequence: short -> sequence: 5",
         "hold_s: 0.1 -> hold_s: -0.1", "at_s: 0.0, pose: home -> pose: home",
         "events: -> events: none #", "say: halfway -> say: 5", "at_s: 1.0, say -> at_s: 99, say",
         "sequence: short -> sequence: short\nloop: -1", "- {at_s: 0.7 -> - {at_s: [0.7",
         "sequence: short -> sequence: short\ntiming: quick", "anchor: true -> anchor: maybe",
         "say: halfway -> run: none:nothing", "say: halfway -> sound: none.wav"),
    ),
    "stage": (
        "check", "hall.yaml",
        ("puppet.yaml -> none.yaml", "idle: idle -> idle: idel", "play: scare, cool -> play: s, c",
         "hall_wink.yaml -> none.yaml", "sensor: door -> sensor: dor", "below_mm: -> under_mm:",
         "start: queue -> start: later", "cue: hi -> cue: visitor", "priority: 1 -> priority: 1000",
         "osc: /scare -> osc: scare", "choose: random -> choose: dice", "go: true -> go: maybe",
         "* * * * * -> * * * *", "* * * * * -> 99 * * * *", "rest: sleep -> rest: slep",
         "limp: true -> limp: 5", "127.0.0.1:9000 -> 127.0.0.1", "127.0.0.1:8440 -> :8440",
         "wait_s: 4 -> wait_s: -4", "cues: -> cuse:", "on: {key: h} -> on: {}",
         "on: {key: h} -> on: {key: h, osc: /h}", "key: h -> key: hh",
         "enabled: false -> enabled: 3",
         "play: wink, start: add -> do: rest, start: add", "log: {folder: -> log: {path:",
         "listen: -> sync: {timecode: {source: smpte}}\nlisten:",
         "listen: -> figures: {a: {robot: puppet.yaml}}\nlisten:",
         "listen: -> conductor: a\nlisten:"),
    ),
    "gait": (
        "gait", "trot.yaml",
        ("pattern: trot -> pattern: jog", "height_mm: 140 -> height_mm: 900",
         "cycle_s: 1.3 -> cycle_s: 0", "left_front_knee -> left_front_nee",
         "stride_mm: 40 -> stride_mm: 400",
         "kind: abduction-thigh-shank -> kind: leg",
         "lengths_mm: [52, 93.4, 90] -> lengths_mm: [52, 93.4]",
         "stance_mm: 52 -> stance: 52", "do: -> dos:", "cycles: 4 -> cycles: 0",
         "step_height_mm: 12 -> step_height_mm: -12",
         "tilt_deg: [0, 12, 0] -> tilt_deg: [0, 80, 0]",
         "  - stand: -> - sit:", "gait: quadruped trot ->", "hip_mm: [100, 37.5] -> hip_mm: [100]"),
    ),
    "faults": (
        "faults", "faults_many.yaml",
        ("faults: -> fault:", "lost_reply -> lost", "ratio: 0.1 -> ratio: 2",
         "ratio: 0.1 -> ration: 0.1",
         "at_s: 0.5 -> at_s: soon", "servo: 1 -> servo: 77", "kind: reset, servo: 1 -> kind: reset",
         "late_s: 0.02, ->", "kind: oversleep -> kind: wrong_id", "kind: oversleep -> kind: hot",
         "kind: reset, servo: 1 -> kind: stored, servo: 1, settings: {LED: 99}",
         "kind: reset, servo: 1 -> kind: input, servo: 1", "at_s: 2.0 -> at_s: 2.0, until_s: 1.0"),
    ),
}  # fmt: skip
"""By kind of file: the command that refuses it, the good file, and changes `old -> new` of it."""

_PAGE = bytearray(512)
_PAGE[:3], _PAGE[15], _PAGE[16], _PAGE[20], _PAGE[22] = b"bow", 1, 10, 2, 32
for _step, _turn in enumerate((2048, 2300)):
    struct.pack_into("<31HBB", _PAGE, 64 + 64 * _step, *[_turn] * 31, 10, 64)
_PAGE[31] = (0xFF - sum(_PAGE)) & 0xFF
_MTN_ROW = " ".join(["512"] * 25)
FOREIGN: Final[dict[str, bytes]] = {
    "bitbots.json": b'{"name":"n","author":"A","keyframes":[{"duration":1.0,"pause":0.5,"goals":'
    b'{"base":1,"elbow":-2},"name":"down"},{"duration":2,"pause":0,"goals":{"base":30}}]}',
    "hulks.json": b'{"initial_positions":{"base":{"yaw":0.0}},"motion":[{"keyframes":[{"duration":'
    b'0.5,"positions":{"base":{"yaw":0.5}}},{"duration":1.5,"positions":{"base":{"yaw":-0.5}}}]}]}',
    "pypot.json": b'{"framerate":50.0,"positions":{"0.5":{"base":[1.0,0.0]},"1.5":'
    b'{"base":[20.0,0.0]}}}',
    "blender.json": b'{"fps":25,"names":{"0":"base"},"positions":[{"0":10},{},{"0":12}],'
    b'"seconds":1}',
    "bottango.json": b'[{"Controller Name":"c","Setup":{"Controller Setup Commands":'
    b'"rSVPin,10,1000,2000,3000,1500"},"Animations":[{"Animation Name":"n",'
    b'"Animation Commands":"sC,10,0,1000,0,25,0,8192,-25,0"}]}]',
    "webots.motion": b"#WEBOTS_MOTION,V1.0,base,elbow\n00:00:000,Rest,-0.5,0.2\n"
    b"00:01:000,Up,*,0.5\n00:02:000,Rest,0.5,0.2\n",
    "robotis.mtn": (
        f"type=motion\nenable={' '.join(['1'] * 26)}\nmotor_type={' '.join(['0'] * 26)}\n"
        f"page_begin\nname=x\nplay_param=0 0 1 1.0 5\nstep=512 {_MTN_ROW} 0.0 0.5\n"
        f"step=600 {_MTN_ROW} 0.1 1\npage_end\n"
    ).encode(),
    "maestro.xml": b'<UscSettings version="1"><Channels><Channel name="base" speed="1"/></Channels>'
    b'<Sequences><Sequence name="s"><Frame name="f" duration="500">6000</Frame>'
    b'<Frame name="g" duration="900">6400</Frame></Sequence></Sequences></UscSettings>',
    "ssc32.csv": b"PROJECT;SEQUENCE;STEP;PIN0;PIN1;T0;T1;TMAX\nW;1;1;0;10;1000;500;1000\n"
    b"W;1;2;0,5;-9;1000;500;\n",
    "pypose.ppr": b"d:2:1024,4096\nPose=up: 612, 620\nPose=dn: 512, 2048\nSeq=s: up|900, dn|900\n",
    "ros.yaml": b"joint_names: [base, elbow]\npoints:\n- {positions: [0.0, 0.5], time_from_start: "
    b"{sec: 0}}\n- positions: &p [1.0, -0.2]\n  time_from_start: 1.5\n  velocities: *p\n",
    "frames.csv": b"# fps: 2\nframe,base_deg,elbow_rad\n0,1.5,0.2\n1,,-3e-1\n2,4,0.5\n",
    "recorded.csv": b"t_s,base,elbow\n"
    + b"".join(b"%.2f,%d,%.1f\n" % (n / 50, min(n, 90), -20 + (n % 60) / 3) for n in range(200)),
    "commands.txt": b"#1D100T500\r#2D-200T1000\r#1D300T500\r#3D0T450\r",
    "robotis.bin": bytes(_PAGE),
}
"""A small whole file for each reader."""

_PULSE: Final = "{name: base, scale: 0.09, offset_deg: -135}"
_IDS: Final = ", ".join(f"ID{n}: {{skip: true}}" for n in range(31) if n not in (1, 3))
MAPS: Final = {
    "hulks.json": "base.yaw: {name: base}",
    "blender.json": "base: {scale: 1.5, offset_deg: -15}",
    "bottango.json": f'"10": {_PULSE}',
    "maestro.xml": f"base: {_PULSE}",
    "ssc32.csv": "PIN0: {name: base}, PIN1: {name: elbow, sign: -1}",
    "pypose.ppr": "ID1: {name: base, scale: 0.5}, ID2: {name: elbow, scale: 0.5}",
    "robotis.mtn": f"ID1: {{name: base}}, ID3: {{name: elbow}}, {_IDS}".partition(", ID26")[0],
    "robotis.bin": f"ID1: {{name: base}}, ID3: {{name: elbow}}, {_IDS}",
}
"""What the joints are, for files that do not say it; the others take the map that is made."""


def write_inputs(folder: Path) -> None:
    """Write all input files that are not examples."""
    for name, text in ROBOTS.items():
        (folder / f"{name}.yaml").write_text(_filled(text), encoding="utf-8")
        show = SHOWS[name].replace("ROBOT", name)
        (folder / f"{name}_show.yaml").write_text(show, encoding="utf-8")
    for name, rows in (*FAULTS.items(), ("input", INPUT_FAULT)):
        text = f"faults: [{rows}]\n"
        (folder / f"faults_{name}.yaml").write_text(text, encoding="utf-8")
    texts = HALL | {
        "trot.yaml": (folder / "sequences/quadruped_trot.yaml")
        .read_text(encoding="utf-8")
        .replace("robots/", "sequences/robots/"),
        "waits.yaml": WAIT_SHOW,
        "too_fast.yaml": TOO_FAST.replace("ANCHOR", "label: far"),
        "too_fast_anchor.yaml": TOO_FAST.replace("ANCHOR", "anchor: true"),
        "wrong.yaml": WRONG,
        "stored.yaml": CONFIGURE,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name, rows in MAPS.items():
        path = folder / f"{name.replace('.', '_')}_joints.yaml"
        path.write_text(f"joints: {{{rows}}}\n", encoding="utf-8")
    for name, data in FOREIGN.items():
        (folder / name).write_bytes(data)


def _filled(text: str) -> str:
    values = {"BAUD": "115200", "FIRMWARE": "370", "MODEL": "LSS-ST1", "MORE": ""}
    for key, value in values.items():
        text = text.replace(key, value)
    return text
