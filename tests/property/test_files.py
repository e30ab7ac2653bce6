"""Laws of the files: what is written reads back, and no content does worse than be refused."""

from __future__ import annotations

import json
import re
import tempfile
from itertools import accumulate
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.keys import NAME_PATTERN
from lss_motion.interchange.importing import read_motion
from lss_motion.interchange.json_motions import BITBOTS
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.check import check_sequence
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Interpolation, Keyframe, Sequence, Timing
from lss_motion.show.write import sequence_text

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
WAVE = (EXAMPLES / "wave.yaml").read_text(encoding="utf-8")
ARM = (EXAMPLES / "robots" / "desk_arm.yaml").read_text(encoding="utf-8")
RANGE_DEG = 3600.0

printable = st.characters(exclude_categories=("Cc", "Cn", "Cs", "Zl", "Zp"))
texts = st.text(printable, min_size=1, max_size=20)
names = texts.filter(lambda name: re.search(NAME_PATTERN, name) is not None)
angles_deg = st.floats(-RANGE_DEG, RANGE_DEG)
spans_s = st.floats(0.001, 100.0)
holds_s = st.just(0.0) | st.floats(0.0, 50.0)


def robot_of(joint_names: list[str]) -> Robot:
    joints = {
        name: Joint(
            name=name,
            servo_id=index,
            bus="main",
            model=SERVO_MODELS["LSS-ST1"],
            position_min_deg=-RANGE_DEG,
            position_max_deg=RANGE_DEG,
            speed_max_deg_s=180.0,
            accel_max_deg_s2=600.0,
        )
        for index, name in enumerate(joint_names)
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="any", path=None, buses={"main": bus}, joints=joints)


@st.composite
def sequences(draw: st.DrawFn) -> tuple[Sequence, Robot]:
    joint_names = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    timing = draw(st.sampled_from(Timing))
    has_times = timing is Timing.AUTHORED or (timing is Timing.FIT and draw(st.booleans()))
    count = draw(st.integers(1, 6))
    holds = draw(st.lists(holds_s, min_size=count, max_size=count))
    spans = draw(st.lists(spans_s, min_size=count, max_size=count))
    ends_s = [0.0, *accumulate(span + hold for span, hold in zip(spans, holds, strict=True))]
    poses = st.dictionaries(st.sampled_from(joint_names), angles_deg, min_size=1)
    keyframes = [
        Keyframe(
            deg=draw(poses),
            at_s=end_s + span if has_times else None,
            hold_s=hold,
            is_anchor=timing is Timing.AUTHORED and draw(st.booleans()),
            ease=draw(st.sampled_from(Interpolation)),
            label=draw(st.just("") | texts),
        )
        for end_s, span, hold in zip(ends_s, spans, holds, strict=False)
    ]
    loops = draw(st.sampled_from([1, 7, None]))
    if loops != 1:  # A loop ends where it began.
        first = {name: deg for k in reversed(keyframes) for name, deg in k.deg.items()}
        at_s = ends_s[-1] + 1.0 if has_times else None
        keyframes.append(Keyframe(deg=first, at_s=at_s, hold_s=0.5))
    sequence = Sequence(
        name=draw(texts),
        keyframes=tuple(keyframes),
        timing=timing,
        fit_duration_s=draw(spans_s) if timing is Timing.FIT else None,
        loop=loops,
    )
    if draw(st.booleans()):
        sequence = replace(sequence, speed_ratio=draw(st.floats(0.01, 1.0)))
    others = draw(st.lists(names, max_size=2, unique=True))
    others = [name for name in others if name not in joint_names]
    sequence = replace(
        sequence,
        tracks=tuple(
            Sequence(name=name, keyframes=(Keyframe(at_s=0.0, hold_s=0.5, deg={name: 1.0}),))
            for name in others
        ),
    )
    return sequence, robot_of([*joint_names, *others])


@given(sequences())
def test_a_written_sequence_reads_back_as_the_same(made: tuple[Sequence, Robot]) -> None:
    sequence, robot = made
    check_sequence(sequence, robot)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.yaml"
        path.write_text(sequence_text(sequence, Path(folder)), encoding="utf-8")
        back = load_sequence(path, robot)
    assert back == sequence
    for before, after in zip(back.keyframes, back.keyframes[1:], strict=False):
        if before.at_s is not None and after.at_s is not None:
            assert after.at_s >= before.at_s + before.hold_s


def read_or_refuse(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "any.yaml"
        path.write_bytes(content)
        for read in (load_robot, load_sequence, read_motion):
            refusal = None
            try:
                read(path)
            except InputError as error:
                refusal = error
            assert refusal is None or (refusal.reason and refusal.path is not None)


@given(st.binary() | st.text().map(str.encode))
def test_no_bytes_do_worse_than_an_input_error(content: bytes) -> None:
    read_or_refuse(content)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    text = draw(st.sampled_from([WAVE, ARM]))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = draw(st.integers(start, min(len(text), start + 30)))
        text = text[:start] + draw(st.text("{}[]:,-&*!|>'\"#%@ \n\t0aé~.", max_size=5)) + text[end:]
    return text.encode()


@given(damaged())
def test_a_damaged_file_does_no_worse_than_an_input_error(content: bytes) -> None:
    read_or_refuse(content)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=8,
)
odd = values | st.lists(values, max_size=3)


@st.composite
def nearly(draw: st.DrawFn) -> dict[str, object]:
    """A robot, sequence or keyframe file with the right keys and odd values."""
    whole = {
        "robot": "x",
        "joints": {"a": {"id": 1, "range_deg": [0, 1], "model": "LSS-ST1", "settings": {"AS": 1}}},
        "sequence": "x",
        "keyframes": [{"at_s": 0, "deg": {"a": 1}}, {"duration": 1, "pause": 0, "goals": {"a": 1}}],
        "loop": 2,
        "poses": {"p": {"a": 1}},
        "defaults": {"response": {"lag_s": 0.1}},
        "buses": {"m": {"port": "sim://"}},
    }
    here: dict[str, object] = whole
    for _ in range(draw(st.integers(0, 2))):
        inner = [v for v in here.values() if isinstance(v, dict) and v]
        inner += [v for part in here.values() if isinstance(part, list) for v in part]
        inner = [v for v in inner if isinstance(v, dict)]
        if inner:
            here = draw(st.sampled_from(inner))
    here[draw(st.sampled_from(sorted(here)))] = draw(odd)
    return whole


@given(nearly())
def test_odd_values_in_the_right_places_do_no_worse_than_an_input_error(
    content: dict[str, object],
) -> None:
    read_or_refuse(json.dumps(content).encode())


@given(nearly() | values)
def test_a_motion_file_is_read_or_refused_whatever_it_holds(content: object) -> None:
    try:
        motion = BITBOTS.motions(Path("any.json"), json.dumps(content).encode())[0]
    except InputError:
        return
    assert motion.keyframes
    assert all(keyframe.deg for keyframe in motion.keyframes)
