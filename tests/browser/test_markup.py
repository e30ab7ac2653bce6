"""Markup in every name of a show and a robot, and in answers of servos, is text in a browser."""

from __future__ import annotations

import json

import pytest
from served_bus import recording_bus, served_bus

from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.physics import ServoSpec
from lss_motion.sim.readings import Readings

IMG = "<img/src=x/onerror=window.owned=1>"
"""Without blanks and quotes, which no name may have."""
TEXT = "\"'><script>window.owned=2</script><svg onload=owned=3>"
"""Labels have 64 characters."""
ROBOT = """\
robot: {robot}
buses: {{main: {{port: {port}, baud_bps: 115200, firmware: 370}}}}
defaults: {{model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}}
joints: {{{pan}: {{id: 1}}, {tilt}: {{id: 2}}}}
poses: {{{pose}: {{{tilt}: 10}}}}
"""
OWNED = """
window.owned !== undefined || document.querySelector(
    'script:not([src]):not([type=importmap]), img[src="x"], svg[onload], a[href^="javascript"]'
) !== null
"""


MARKUP = {"robot": TEXT, "pan": f"pan{IMG}", "tilt": f"tilt{IMG}", "pose": f"up{IMG}"}
INHERITED = {"robot": "toString", "pan": "__proto__", "tilt": "constructor", "pose": "valueOf"}
"""Names that every object of JavaScript has already."""


@pytest.fixture(params=[MARKUP, INHERITED], ids=["markup", "inherited"])
def hostile(tmp_path, monkeypatch, request):
    names = request.param
    quoted = {key: json.dumps(value) for key, value in names.items()}
    port = tmp_path / "port"
    (tmp_path / "robot.yaml").write_text(ROBOT.format(port=port, **quoted))
    frames = [
        {"at_s": 0, "deg": {names["pan"]: 0, names["tilt"]: 0}, "label": TEXT},
        {"at_s": 1, "pose": names["pose"], "label": "<a href=javascript:owned=4>go</a>"},
        {"at_s": 9, "deg": {names["pan"]: 0, names["tilt"]: 0}, "label": IMG},
    ]
    show = {"sequence": TEXT, "robot": "robot.yaml", "keyframes": frames}
    (tmp_path / "show.yaml").write_text(
        "".join(f"{key}: {json.dumps(value)}\n" for key, value in show.items())
    )
    value = Readings.value

    def answer(self, row, *arguments):
        own = value(self, row, *arguments)
        return f"{own}{IMG}" if {"QMS", "QN"} & {*row.queries} else own

    monkeypatch.setattr(Readings, "value", answer)
    st1 = SERVO_MODELS["LSS-ST1"]
    bus = recording_bus(*(ServoSpec(servo_id=number, model=st1) for number in (1, 2)))
    with served_bus(bus, port):
        yield tmp_path / "show.yaml"


def test_no_name_and_no_answer_runs_in_a_page(studio, opened, hostile):
    with studio(hostile) as own, opened(own) as page:
        page.wait("document.body.textContent.includes('onerror=window.owned=1')")
        for key in "123456":
            page.key(key)
            page.idle()
            assert not page.run(OWNED), f"page {key}"
        page.key("1")
        page.key(" ")
        page.idle()
        assert not page.run(OWNED)
        assert page.run("Object.keys(Object.prototype).length === 0")
        assert page.run("typeof {}.constructor === 'function' && ({}).toString() !== undefined")
        page.key("Escape")
