"""Maestro settings: frames, channels, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.interchange.reader import ForeignMotion, Measure
from lss_motion.interchange.step_tables import MAESTRO

SAMPLE = """\
<!--Pololu Maestro servo controller settings file-->
<UscSettings version="1">
  <Channels>
    <Channel name="pan" mode="Servo" speed="0" acceleration="0" neutral="6000" range="1905" />
    <Channel name="" mode="Servo" speed="20" acceleration="0" />
  </Channels>
  <Sequences>
    <Sequence name="look">
      <Frame name="left" duration="500">4000 6000</Frame>
      <Frame name="right" duration="1000">8000 0</Frame>
    </Sequence>
    <Sequence name="rest">
      <Frame name="middle" duration="500">6000 6000</Frame>
    </Sequence>
  </Sequences>
  <Script ScriptDone="true">goto begin</Script>
</UscSettings>
"""


def test_maestro_targets_are_quarters_of_microseconds_reached_at_the_end_of_a_frame() -> None:
    look, rest = MAESTRO.motions(Path("m"), SAMPLE.encode())
    assert isinstance(look, ForeignMotion)
    pan, second = look.channels
    assert (look.name, rest.name) == ("look", "rest")
    assert (pan.name, pan.unit, second.name) == ("pan", Measure.US, "channel1")
    assert (pan.times_s.tolist(), pan.values.tolist()) == ([0.5, 1.5], [1000.0, 2000.0])
    assert second.values.tolist() == [1500.0]
    assert "Not carried over: channel1 is switched off" in look.comments
    assert "Not carried over: speed and acceleration of channel1" in look.comments


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("</UscSettings>", "", 18, "it was cut off, copy it again"),
        ('duration="500">4000', 'duration="soon">4000', 9, "'soon' is not a whole number"),
        ('duration="500">4000', ">4000", 9, "this frame has no duration"),
        ('version="1">', 'version="1">&bomb;', 2, "not XML"),
        ("<UscSettings", "<!DOCTYPE a [<!ENTITY b 'c'>]><UscSettings", 2, "document type"),
    ],
)
def test_wrong_maestro_xml_is_refused_with_its_line(refusal, old, new, line, reason) -> None:
    error = refusal(MAESTRO, SAMPLE.replace(old, new, 1))
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_maestro_script_is_not_read(refusal) -> None:
    text = SAMPLE[: SAMPLE.index("  <Sequences>")] + "</UscSettings>\n"
    assert "scripts are programs" in refusal(MAESTRO, text).reason
