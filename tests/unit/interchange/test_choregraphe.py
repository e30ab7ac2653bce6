"""Choregraphe: timelines of `.xar` and `.qianim` files, the export to Python, and errors."""

from __future__ import annotations

import pytest

from lss_motion.interchange.choregraphe import CHOREGRAPHE
from lss_motion.interchange.reader import ForeignMotion, Measure
from tests.unit.interchange.conftest import PATH

CURVES = """\
<ActuatorList model="">
<ActuatorCurve name="value" actuator="HeadYaw" recordable="1" mute="0" unit="0">
<Key frame="35" value="20"/>
<Key frame="10" value="-10.5"><Tangent side="left" interpType="bezier" abscissaParam="-3"
 ordinateParam="0"/></Key>
</ActuatorCurve>
<ActuatorCurve name="value" actuator="RHand" mute="0" unit="1"><Key frame="5" value="0.5"/>
</ActuatorCurve>
<ActuatorCurve name="value" actuator="LHand" mute="1" unit="1"><Key frame="5" value="0.5"/>
</ActuatorCurve>
</ActuatorList>
"""
XAR = f"""\
<?xml version="1.0" encoding="UTF-8" ?>
<ChoregrapheProject xmlns="http://www.aldebaran-robotics.com/schema/choregraphe/project.xsd">
<Box name="root" id="-1"><script language="4"><content><![CDATA[if x < y:]]></content></script>
<Timeline enable="0"><BehaviorLayer name="l"><BehaviorKeyframe name="k" index="1"><Diagram>
<Box name="Wave" id="2"><Timeline enable="1" fps="25" start_frame="1" size="67">
{CURVES}</Timeline></Box>
<Box name="Say" id="3"/>
</Diagram></BehaviorKeyframe></BehaviorLayer></Timeline></Box></ChoregrapheProject>
"""
PYTHON = """\
# Choregraphe bezier export in Python.
from naoqi import ALProxy
names = list()
times = list()
keys = list()

names.append("HeadYaw")
times.append([0.96, 1.76])
keys.append([[-0.36505, [3, -0.32, 0], [3, 0.26, 0]], [0.44, [3, -0.26, 0], [3, 0, 0]]])

# names.append("LHand")
names.append("RHand")
times.append([ 0.80000, 1.5])
keys.append([ 0.29, 1e-1])

motion = ALProxy("ALMotion")
motion.angleInterpolationBezier(names, times, keys)
"""


def test_a_timeline_has_the_name_of_its_box_and_the_rate_of_its_frames(read_one) -> None:
    motion = read_one(CHOREGRAPHE, XAR)
    yaw, hand = motion.channels
    assert motion.name == "Wave"
    assert (yaw.name, yaw.unit, hand.unit) == ("HeadYaw", Measure.DEG, Measure.RAW)
    assert (yaw.times_s.tolist(), yaw.values.tolist()) == ([0.4, 1.4], [-10.5, 20.0])
    assert yaw.lines.tolist() == [9, 8]
    assert "Not carried over: actuator LHand, which is muted" in motion.comments


def test_each_timeline_with_keys_is_a_motion() -> None:
    second = f'<Box name="Nod"><Timeline fps="50">{CURVES}</Timeline></Box><Box name="Say"'
    wave, nod = CHOREGRAPHE.motions(PATH, XAR.replace('<Box name="Say"', second).encode())
    assert isinstance(nod, ForeignMotion)
    assert (wave.name, nod.name) == ("Wave", "Nod")
    assert nod.channels[0].times_s.tolist() == [0.2, 0.7]


def test_an_animation_of_pepper(read_one) -> None:
    text = (
        '<Animation typeVersion="2.0" xmlns:editor="x"><ActuatorCurve fps="50" mute="false" '
        'actuator="HeadPitch" unit="degree"><Key value="1" frame="0"/><Key value="2" frame="50"/>'
        "</ActuatorCurve></Animation>"
    )
    (pitch,) = read_one(CHOREGRAPHE, text).channels
    assert (pitch.times_s.tolist(), pitch.values.tolist()) == ([0.0, 1.0], [1.0, 2.0])


def test_the_export_to_python_is_read_as_text(read_one) -> None:
    yaw, hand = read_one(CHOREGRAPHE, PYTHON).channels
    assert (yaw.unit, hand.name, hand.unit) == (Measure.RAD, "RHand", Measure.RAW)
    assert (yaw.times_s.tolist(), yaw.values.tolist()) == ([0.96, 1.76], [-0.36505, 0.44])
    assert (hand.times_s.tolist(), hand.values.tolist()) == ([0.8, 1.5], [0.29, 0.1])


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (XAR.replace('unit="0"', 'unit="7"'), 7, "unit '7' of actuator 'HeadYaw' is not known"),
        (XAR.replace('fps="25"', 'fps="0"'), 5, "fps 0 must be more than 0"),
        (XAR.replace('frame="35"', 'frame="10"'), 9, "'HeadYaw' has two keys in frame 10"),
        (XAR.replace('frame="35"', 'frame="-3"'), 8, "'-3' is not a whole number"),
        (XAR.replace('value="20"', 'value="x"'), 8, "'x' is not a number"),
        (XAR.replace("RHand", "HeadYaw"), 12, "has two curves in one timeline"),
        (XAR.replace('actuator="RHand"', ""), 12, "must name its actuator"),
        (XAR[:700], 12, "not XML"),
        (XAR.replace("ActuatorCurve", "Other"), None, "has no timeline with keys"),
        ("<!DOCTYPE a []>" + XAR[40:], 1, "declares a document type"),
        (PYTHON.replace("[0.96, 1.76]", "[0.96]"), 9, "2 keys of 'HeadYaw' for 1 times"),
        (PYTHON.replace("[0.96, 1.76]", "[1.76, 0.96]"), 9, "the times of 'HeadYaw' must increase"),
        (PYTHON.replace("[0.96, 1.76]", "range(2)"), 8, "'range(2)' is no list of numbers"),
        (PYTHON.replace("RHand", "HeadYaw"), 12, "joint 'HeadYaw' is named twice"),
    ],
)
def test_what_is_wrong_is_refused_with_its_line(refusal, text: str, line, reason: str) -> None:
    error = refusal(CHOREGRAPHE, text)
    assert reason in error.reason
    assert error.line == line
