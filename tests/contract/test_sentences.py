"""Every sentence of the three documents that says something checkable, one row a sentence.

`sentences/*.yaml` hold the rows: `line` and `section` of the document, `says` (the sentence,
shortened), and one of

    do       steps against a simulated servo, in bytes where bytes can show it
    test     the test that checks it: `file.py::name` below `tests`
    decided  the reason why nothing is checked, or why another thing is

Steps: `> LINE` sends a line, `raw BYTES` sends no CR but `|`; `? LINE = REPLY` compares all that
comes back (CR as `|`; several lines are sent at once); `? LINE ~ N ± M` the number of the reply;
`rate BPS` sets that of the host; `wait S`; `horn DEG` and `turns DEG/S` judge the simulated horn,
`horns DEG DEG` that of the second servo too, `limp` and `holds` its motor, `lamp COLOUR [blinking]`
its LED; `power` switches off and on; `pulse US` and `pulse off` are RC pulses. `servo` gives what
the servo is: `model`, `id`, `firmware`, `start` (degrees), `twin` (id of a second one), `physics`,
`stuck`, `stored`. `effect: none` marks a row in which nothing that is sent has an effect.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml

import lss_motion
from lss_motion.protocol.constants import Family, Led
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics, ServoSpec

TESTS = Path(__file__).resolve().parents[1]
DOCUMENTS = {"lss": "LSS-HS1", "lss_pro": "LSS-P-S1", "lss_2io": "LSS-2IO"}
TITLES = {"lss": "LSS", "lss_pro": "PRO", "lss_2io": "2IO"}
WITHIN_DEG = 0.15
ACTING = (">", "raw", "rate", "pulse")
"""Steps that do something to a servo."""


def rows_of(document: str) -> list[dict[str, Any]]:
    text = (Path(__file__).parent / "sentences" / f"{document}.yaml").read_text(encoding="utf-8")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # Every worker reads this.
    rows: list[dict[str, Any]] = yaml.load(text, Loader=loader)
    return rows


ROWS = {document: rows_of(document) for document in DOCUMENTS}
EXECUTABLE = [
    pytest.param(document, row, id=f"{document}-{row['line']}-{number}")
    for document, rows in ROWS.items()
    for number, row in enumerate(rows)
    if "do" in row
]


class SentenceBench:
    """A servo, and perhaps a second one, on a bus in virtual time."""

    def __init__(self, document: str, servo: dict[str, Any]) -> None:
        self._model = SERVO_MODELS[servo.get("model", DOCUMENTS[document])]
        is_board = self._model.family is Family.IO2
        self._ids = [servo.get("id", 209 if is_board else 5)]
        self._ids += [servo["twin"]] if "twin" in servo else []
        self._firmware = servo.get("firmware", 779 if document == "lss_pro" else 370)
        self._physics = Physics(
            noise_deg=0.0, corrupt_reply_ratio=0.0, usb_back_s=1.0, **servo.get("physics", {})
        )
        self._faults = [Fault(kind=FaultKind.STUCK)] if servo.get("stuck") else []
        self._stored = [servo.get("stored", {})] * len(self._ids)
        self._start_deg = [float(servo.get("start", 0.0))] * len(self._ids)
        self._power_on()

    def _power_on(self) -> None:
        self.bus = SimBus(
            [
                ServoSpec(servo_id=servo_id, model=self._model, start_deg=start, eeprom=stored)
                for servo_id, start, stored in zip(
                    self._ids, self._start_deg, self._stored, strict=True
                )
            ],
            baud_bps=115200,
            firmware=self._firmware,
            physics=self._physics,
            faults=self._faults,
        )
        self.now_ns = 0
        self.bus.advance(0)

    def power(self) -> None:
        """Switch off and on: what is stored stays, and the angle within a turn."""
        servos = self.bus._servos
        self._stored = [
            {name: value for name, value in servo.settings.eeprom.items() if value is not None}
            for servo in servos
        ]
        self._start_deg = [
            (float(self.bus.motors.horn_deg(servo.index, self.now_ns)) + 180.0) % 360.0 - 180.0
            for servo in servos
        ]
        self._ids = [int(stored["ID"]) for stored in self._stored]
        self._power_on()

    def send(self, text: str) -> None:
        """Send bytes; `|` is CR."""
        self.bus.write(text.replace("|", "\r").encode(), self.now_ns)
        self.wait_s(max(0.01, self.bus.backlog_ns(self.now_ns) / 1e9 + 0.002))

    def ask(self, line: str) -> str:
        self.bus.write(f"{line}|".replace("|", "\r").encode(), self.now_ns)
        received = b""
        while (end_ns := self.bus.next_arrival_ns()) is not None:
            self.now_ns = max(self.now_ns, end_ns)
            received += self.bus.read(self.now_ns)
        self.wait_s(0.01)
        return received.decode("latin-1").replace("\r", "|")

    def wait_s(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)
        self.bus.advance(self.now_ns)

    def step(self, text: str) -> None:
        """Do one step, or assert what it says."""
        word, _, rest = text.partition(" ")
        match word:
            case ">":
                self.send(f"{rest}|")
            case "raw":
                self.send(rest)
            case "rate":
                self.bus.set_host_rate(int(rest), self.now_ns)
            case "?":
                self._compare(rest)
            case "wait":
                self.wait_s(float(rest))
            case "power":
                self.power()
            case "pulse":
                pulse_us = None if rest == "off" else int(rest)
                self.bus.set_pulse(self._ids[0], pulse_us, self.now_ns)
            case _:
                self._judge(word, rest)

    def _compare(self, text: str) -> None:
        """Compare what comes back."""
        near = re.fullmatch(r"(\S+) ~ (-?[\d.]+) ± ([\d.]+)", text)
        if near is None:
            line, _, wanted = text.partition(" =")
            assert self.ask(line) == (f"{wanted.strip()}|" if wanted.strip() else ""), text
            return
        reply = self.ask(near[1])
        number = re.fullmatch(r"\*\d*[A-Z]+(-?\d+)\|", reply)
        assert number, reply
        assert int(number[1]) == pytest.approx(float(near[2]), abs=float(near[3])), text

    def _judge(self, word: str, rest: str) -> None:
        """Compare the first servo itself."""
        motors = self.bus.motors
        match word:
            case "horn" | "horns":
                for index, wanted_deg in enumerate(map(float, rest.split())):
                    horn_deg = motors.horn_deg(index, self.now_ns)
                    assert horn_deg == pytest.approx(wanted_deg, abs=WITHIN_DEG)
            case "turns":
                deg_s = motors.horn_deg_s(0, self.now_ns)
                assert deg_s == pytest.approx(float(rest), abs=max(0.5, 0.01 * abs(float(rest))))
            case "limp" | "holds":
                assert bool(motors._drives.is_powered[0]) is (word == "holds")
            case "lamp":
                colour, _, blinking = rest.partition(" ")
                lamp = self.bus.lamp(self._ids[0], self.now_ns)
                assert lamp == (Led[colour.upper()], blinking == "blinking")
            case _:
                raise AssertionError(f"unknown step {word!r}")


@pytest.mark.parametrize(("document", "row"), EXECUTABLE)
def test_the_simulated_servo_does_what_the_sentence_says(document, row):
    bench = SentenceBench(document, row.get("servo", {}))
    for step in row["do"]:
        bench.step(step)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_row_is_checked_or_decided(document):
    for row in ROWS[document]:
        kinds = [kind for kind in ("do", "test", "decided") if kind in row]
        assert len(kinds) == 1, row
        assert row["says"], row
        assert isinstance(row["line"], int), row
        assert len(row.get("decided", "a reason in words")) > 15, row
        if "do" in row:
            assert any(step[0] != ">" for step in row["do"]), f"nothing is judged: {row}"


@pytest.mark.parametrize("document", DOCUMENTS)
def test_what_a_row_judges_comes_of_what_it_sends(document):
    """A row that passes when nothing is sent shows nothing, unless that is what it says."""
    for row in ROWS[document]:
        left = [step for step in row.get("do", []) if step.split(" ")[0] not in ACTING]
        if len(left) == len(row.get("do", [])):
            continue
        bench = SentenceBench(document, row.get("servo", {}))
        with contextlib.nullcontext() if "effect" in row else pytest.raises(AssertionError):
            for step in left:
                bench.step(step)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_named_test_exists(document):
    for row in ROWS[document]:
        if "test" in row:
            file, _, name = row["test"].partition("::")
            text = (TESTS / file).read_text(encoding="utf-8")
            assert re.search(rf"^def {re.escape(name)}\(", text, re.MULTILINE), row


def test_the_count_of_the_sentences_is_that_of_the_facts():
    facts = (Path(lss_motion.__file__).parent / "FACTS.md").read_text(encoding="utf-8")
    for document, rows in ROWS.items():
        counts = Counter(kind for row in rows for kind in ("do", "test", "decided") if kind in row)
        line = (
            f"| {TITLES[document]} | {len(rows)} | {counts['do']} | {counts['test']} |"
            f" {counts['decided']} |"
        )
        assert line in facts.splitlines()
        assert counts["do"] > len(rows) / 2
        assert [row["line"] for row in rows] == sorted(row["line"] for row in rows)
