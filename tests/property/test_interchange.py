"""Laws of foreign files: nothing in them does worse than be refused; what we write reads back."""

from __future__ import annotations

import io
import sqlite3
from contextlib import closing
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lss_motion.errors import InputError
from lss_motion.interchange.export import EXPORT_NAMES, PlanSamples, exported
from lss_motion.interchange.importing import READERS
from lss_motion.interchange.reader import (
    Channel,
    ForeignMotion,
    LabelTrack,
    Measure,
    Reader,
    RefusedMotion,
)
from lss_motion.interchange.recorded import interpolated
from lss_motion.interchange.reduce import ROUNDING_DEG, reduced
from lss_motion.show.model import Interpolation
from tests.unit.interchange.test_mcap_files import cdr, mcap_file
from tests.unit.interchange.test_numpy_files import npz

PAGE = bytearray(512)
PAGE[:3], PAGE[15], PAGE[16], PAGE[20], PAGE[22] = b"bow", 1, 10, 1, 32
PAGE[64:126] = (2048).to_bytes(2, "little") * 31
PAGE[127] = 64
PAGE[31] = (0xFF - sum(PAGE)) & 0xFF


def sqlite_file(rows: list[tuple[int, ...]]) -> bytes:
    """Return an action group as SQLite writes it."""
    with closing(sqlite3.connect(":memory:")) as base:
        base.execute("PRAGMA page_size = 512")
        base.execute("CREATE TABLE ActionGroup([Index] INT, Time INT, Servo1 INT, Servo2 INT)")
        base.executemany("INSERT INTO ActionGroup VALUES (?, ?, ?, ?)", rows)
        base.commit()
        return base.serialize()


def parquet_file() -> bytes:
    """Return an episode of a dataset as pyarrow writes it."""
    pa, pq = import_module("pyarrow"), import_module("pyarrow.parquet")
    columns = {
        "observation.state": pa.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], pa.list_(pa.float32())),
        "timestamp": pa.array([0.0, 0.1, 0.2], pa.float32()),
        "episode_index": pa.array([0, 0, 1], pa.int64()),
    }
    out = io.BytesIO()
    pq.write_table(pa.table(columns), out)
    return out.getvalue()


MTN_ROW = " ".join(["512"] * 26)
SEEDS = {
    "bitbots": b'{"name":"n","keyframes":[{"duration":1.0,"pause":0.5,"goals":{"a":1,"b":-2}},'
    b'{"duration":2,"pause":0,"goals":{"a":3}}]}',
    "hulks": b'{"initial_positions":{"head":{"yaw":0.0}},"motion":[{"keyframes":[{"duration":0.5,'
    b'"positions":{"head":{"yaw":0.5}}}]}]}',
    "pypot": b'{"framerate":50.0,"positions":{"0.5":{"m":[1.0,0.0]},"1.5":{"m":[2.0,0.0]}}}',
    "blender": b'{"fps":25,"names":{"0":"a"},"positions":[{"0":10,"1":5},{},{"0":30}],"seconds":1}',
    "bottango": b'[{"Controller Name":"c","Setup":{"Controller Setup Commands":'
    b'"rSVPin,10,1000,2000,3000,1500\\nrSVI2C,64,2,1,2,3,4"},"Animations":[{"Animation Name":"n",'
    b'"Animation Commands":"sC,10,0,100,0,25,0,8192,-25,0\\nsSY,sC,10,200,50,1,2,3,4,5,6;642,0,9,'
    b'1,2,3,4,5,6;"}]}]',
    "bvh": b"HIERARCHY\nROOT hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition "
    b"Zrotation Xrotation Yrotation\nJOINT a\n{\nOFFSET 0 1 0\nCHANNELS 1 Yrotation\nEnd Site\n{\n"
    b"OFFSET 0 1 0\n}\n}\n}\nMOTION\nFrames: 2\nFrame Time: 0.04\n0 0 0 1 2 3 4\n0 0 0 1 2 5 -4\n",
    "webots": b"#WEBOTS_MOTION,V1.0,a,b\n00:00:000,Rest,-0.5,0.2\n00:01:000,Up,*,0.5\n",
    "mtn": f"type=motion\nenable={' '.join(['1'] * 26)}\nmotor_type={' '.join(['0'] * 26)}\n"
    f"page_begin\nname=x\nplay_param=0 0 1 1.0 5\nstep={MTN_ROW} 0.0 0.5\nstep={MTN_ROW} 0.1 1\n"
    "page_end\n".encode(),
    "maestro": b'<UscSettings version="1"><Channels><Channel name="a" speed="1"/></Channels>'
    b'<Sequences><Sequence name="s"><Frame name="f" duration="500">6000 0</Frame></Sequence>'
    b"</Sequences></UscSettings>",
    "ssc32-csv": b"PROJECT;SEQUENCE;STEP;PIN0;PIN1;T0;T1;TMAX\nW;1;1;0;90;1000;500;1000\n"
    b"W;1;2;0,5;-90;1000;500;\n",
    "pypose": b"d:2:1024,4096\nPose=up: 612, 620\nPose=dn: 512, 2048\nSeq=s: up|250, dn|250\n",
    "ros": b"joint_names: [a, lift]\npoints:\n- {positions: [0.0, 1], time_from_start: {sec: 0}}\n"
    b"- positions: &p [1.0, 2]\n  time_from_start: 1.5\n  velocities: *p\n",
    "csv": b"# fps: 25\nframe,a_deg,b_rad\n0,1.5,2\n1,,-3e-1\n2,4,5\n",
    "commands": b"#5P1500#6P1600T1000\r#5P1700T500\r\n#1D100T500#254H\n#254D300T500\n",
    "robotis-bin": bytes(PAGE),
    "d6a": sqlite_file([(1, 500, 480, 0), (2, 1000, 500, 1000)]),
    "opencat": b"const int8_t wk[] PROGMEM = {\n2, 0, 0, 1,\n 1, 2, 3, 4, 5, 6, 7, 8,\n 9, 8, 7, 6,"
    b"5, 4, 3, 2,};\nconst int8_t hi[] PROGMEM = {-2, 0, -30, 2,\n 0, 1, 2,\n 1, 2, 8, 1, 0, 0,\n "
    b"9, 5, 10, 0, 1, 20,};\n",
    "reachy": b'{"description":"d","time":[0,1],"set_target_data":[{"head":[[1,0,0,0],[0,1,0,0],'
    b'[0,0,1,0],[0,0,0,1]],"antennas":[0.1,0.2],"body_yaw":0.5},{"antennas":[0.2,0.3]}]}',
    "choregraphe": b'<ChoregrapheProject><Box name="w"><Timeline fps="25"><ActuatorList>'
    b'<ActuatorCurve actuator="a" mute="0" unit="0"><Key frame="5" value="1.5"/>'
    b"</ActuatorCurve></ActuatorList></Timeline></Box></ChoregrapheProject>",
    "nubots": b"- duration: 190\n  targets:\n    - {id: a, position: 0.5, gain: 3}\n"
    b"- duration: 90\n  targets: [{id: a, position: 1}]\n",
    "numpy": npz(time_s=np.arange(3.0), a_rad=np.arange(3.0)),
    "poses": b'[{"name":"up","deg":{"a":10,"b":-5.5},"duration_s":0.5,"hold_ms":100},'
    b'{"b":0.5,"a":20,"duration_s":1}]',
}
"""A small whole file of each format; what hypothesis damages."""

PRAAT = """\
File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 1
tiers? <exists>
size = 2
item []:
 item [1]:
  class = "IntervalTier"
  name = "p"
  xmin = 0
  xmax = 1
  intervals: size = 1
  intervals [1]:
   xmin = 0
   xmax = 1
   text = "AA1"
 item [2]:
  class = "TextTier"
  name = "q"
  xmin = 0
  xmax = 1
  points: size = 1
  points [1]:
   number = 0.5
   mark = "a ""b"" c"
"""
PAPAGAYO = "lipsync version 1\nv.wav\n24\n48\n1\nA\nHi\n1\nHi\n2\n9\n1\nHi 2 9 2\n2 etc\n4 AI\n"
SEEDS |= {
    "rhubarb": b'{"metadata":{"soundFile":"v.wav","duration":1},"mouthCues":[{"start":0.0,'
    b'"end":0.2,"value":"X"},{"start":0.2,"end":0.5,"value":"D"}]}',
    "papagayo": PAPAGAYO.encode(),
    "praat": PRAAT.encode(),
    "xlights": b'<timing name="V"><EffectLayer><Effect label="AI" starttime="100" endtime="200"/>'
    b'</EffectLayer><EffectLayer><Effect label="b" starttime="1" endtime="2"/></EffectLayer>'
    b"</timing>",
    "audacity": b"0.5\t0.5\thome\n\\\t6928.4\t6928.4\n1.0\t2.5\tb c\n",
}

if find_spec("pyarrow"):
    SEEDS["lerobot"] = parquet_file()
if find_spec("mcap"):
    SEEDS["mcap"] = mcap_file([(n * 10**8, cdr({"a": n / 10}, n * 10**8)) for n in range(3)])

TOKENS = {
    b"{", b"}", b"[", b"]", b",", b";", b":", b"\n", b"\r", b"\0", b"#", b"*", b'"', b"=", b"|",
    b"&", b"<", b">", b"-", b".", b"0", b"9" * 30, b"1e999", b"nan", b"NaN", b"-1", b"\xff", b"T0",
    b"\xef\xbb\xbf", b"T500", b"null", b"true", b"[" * 2000, b"&a [*a]", b"page_begin\n", b" ",
    b"!!python/object", b"<!DOCTYPE a>", b"\xe2\x80\xa8",
}  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, seed: bytes) -> bytes:
    data = seed
    for _ in range(draw(st.integers(1, 5))):
        start = draw(st.integers(0, len(data)))
        end = draw(st.integers(start, min(len(data), start + 12)))
        middle = draw(st.sampled_from(sorted(TOKENS)) | st.binary(max_size=4) | st.just(b""))
        data = data[:start] + middle + data[end:]
    return data


def fuzz_one(reader: Reader, data: bytes) -> bool:
    """Read `data` and return whether it holds a motion that can be read.

    A reader may only return motions with channels, tracks with labels, and refusals with a reason,
    or raise `InputError`. Any other exception fails. `tools/campaign readers` calls this, too.
    """
    reader.recognises(data)
    motions: tuple[ForeignMotion | LabelTrack | RefusedMotion, ...]
    try:
        motions = reader.motions(Path("fuzz.bin"), data)
    except InputError as error:
        motions = (RefusedMotion(name="the file", error=error),)
    assert motions, "neither a motion nor a refusal"
    for motion in motions:
        if isinstance(motion, RefusedMotion):
            assert motion.error.reason, "a refusal without a reason"
        elif isinstance(motion, LabelTrack):
            assert motion.spans, "a track without a label, which checks its own times when made"
        else:
            # `Channel` checks its own values when it is made.
            assert motion.channels, "a motion without a joint"
            assert len({channel.name for channel in motion.channels}) == len(motion.channels)
    return any(not isinstance(motion, RefusedMotion) for motion in motions)


def by_name() -> list[object]:
    return [pytest.param(reader, id=reader.name) for reader in READERS if reader.name in SEEDS]


def test_every_reader_is_fuzzed() -> None:
    missing = {reader.name for reader in READERS} - SEEDS.keys()
    extras = {"lerobot": "pyarrow", "mcap": "mcap"}
    assert missing == {name for name, library in extras.items() if not find_spec(library)}


@pytest.mark.parametrize("reader", by_name())
def test_the_seed_of_every_format_is_whole_and_recognised_as_that_alone(reader: Reader) -> None:
    data = SEEDS[reader.name]
    assert fuzz_one(reader, data)
    assert next(r for r in READERS if r.recognises(data)) is reader


@pytest.mark.parametrize("reader", by_name())
@settings(suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_no_damage_does_worse_than_a_refusal(reader: Reader, data: st.DataObject) -> None:
    fuzz_one(reader, data.draw(damaged(SEEDS[reader.name])))


@pytest.mark.parametrize("reader", by_name())
def test_no_end_of_a_file_does_worse_than_a_refusal(reader: Reader) -> None:
    data = SEEDS[reader.name]
    for length in range(len(data)):
        fuzz_one(reader, data[:length])


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode()))
def test_no_bytes_at_all_do_worse_than_a_refusal(data: bytes) -> None:
    for reader in READERS:
        fuzz_one(reader, data)


curves_deg = st.lists(st.floats(-90.0, 90.0), min_size=2, max_size=80)


@given(
    curves_deg,
    st.sampled_from([Interpolation.SPLINE, Interpolation.SMOOTH, Interpolation.LINEAR]),
    st.floats(0.01, 30.0),
)
def test_any_recording_is_reduced_within_the_tolerance(
    curve_deg: list[float], ease: Interpolation, tolerance_deg: float
) -> None:
    channel = Channel(
        name="a",
        unit=Measure.DEG,
        times_s=np.round(np.arange(len(curve_deg)) / 50.0, 6),
        values=np.array(curve_deg),
    )
    motion = ForeignMotion(
        path=Path("r"), name="r", channels=(channel,), notes={}, is_recording=True
    )
    (own,) = reduced(motion, tolerance_deg, ease)[0].channels
    error_deg = interpolated(ease, own.times_s, own.values, channel.times_s) - channel.values
    assert np.abs(error_deg).max() <= tolerance_deg + 2.0 * ROUNDING_DEG


@given(
    st.lists(st.floats(-180.0, 180.0), min_size=1, max_size=20),
    st.sampled_from([1.0, 24.0, 29.97, 100.0]),
    st.sampled_from(EXPORT_NAMES),
)
def test_every_export_is_read_back(angles: list[float], rate_hz: float, name: str) -> None:
    times_s = np.arange(len(angles)) / rate_hz
    column = np.array(angles)[:, None]
    samples = PlanSamples(
        name="x",
        joints=("a",),
        rate_hz=rate_hz,
        times_s=times_s,
        angles_deg=column,
        speeds_deg_s=0.0 * column,
    )
    data = exported(samples, name).encode()
    reader = next(reader for reader in READERS if reader.recognises(data))
    (motion,) = reader.motions(Path("x"), data)
    assert isinstance(motion, ForeignMotion)
    np.testing.assert_allclose(motion.channels[0].times_s, times_s, atol=1e-6)
    read_deg = [keyframe.deg["a"] for keyframe in motion.keyframes]
    np.testing.assert_allclose(read_deg, angles, atol=0.0501)
