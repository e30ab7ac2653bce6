"""The simulated servos against the three documents: every printed reply, and every keyword."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import pytest

from lss_motion.protocol.codec import FAMILY_TABLES, read_reply
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import Reply, ReplyParser
from lss_motion.protocol.table import Device, Form, ReplyShape, Suffix
from lss_motion.robot.model import ServoModel
from lss_motion.sim.boards import SENSORS
from lss_motion.sim.bus import SimBus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics, ServoSpec
from tests.protocol_table import DOCUMENT_ROW_COUNT, EXAMPLES, ROWS

NAMES = {Family.LSS: "LSS-HS1", Family.LSS_PRO: "LSS-P-S1", Family.IO2: "LSS-2IO"}
FIRMWARES = {Family.LSS: 370, Family.LSS_PRO: 779, Family.IO2: 370}
"""The page of the LSS-PRO prints the status codes of the firmware before 780 (FACTS.md P5)."""
WIRE_PER_DEG = {Family.LSS: 10, Family.LSS_PRO: 100, Family.IO2: 10}
STUCK = (Fault(kind=FaultKind.STUCK),)
QUIET = {"noise_deg": 0.0, "corrupt_reply_ratio": 0.0, "usb_back_s": 1.0}


@dataclass(frozen=True)
class State:
    """The set-up that makes a servo send a printed reply: servo, commands before, and the query."""

    lines: tuple[str, ...] = ()
    wait_s: float = 0.05
    query: str = ""
    physics: dict = field(default_factory=dict)
    spec: dict = field(default_factory=dict)
    name: str = ""
    firmware: int | None = None
    faults: tuple[Fault, ...] = ()
    inputs: dict = field(default_factory=dict)


class DocumentHost:
    def __init__(self, family: Family, servo_id: int, state: State = State()):
        model = ServoModel(
            name=state.name or NAMES[family],
            family=family,
            speed_max_deg_s=600.0,
            wire_per_deg=WIRE_PER_DEG[family],
        )
        self.bus = SimBus(
            [ServoSpec(servo_id=servo_id, model=model, **state.spec)],
            baud_bps=115200,
            firmware=state.firmware or FIRMWARES[family],
            physics=Physics(**(QUIET | state.physics)),
            faults=state.faults,
        )
        self.now_ns = 0
        self.bus.advance(0)
        for pin_id, raw in state.inputs.items():
            self.bus.set_input(pin_id, raw, 0)
        for line in state.lines:
            self.send(line)
        self.wait_s(state.wait_s)

    def send(self, line: str) -> None:
        self.bus.write(f"{line}\r".encode(), self.now_ns)
        self.wait_s(0.02)

    def query(self, line: str) -> bytes:
        self.bus.write(f"{line}\r".encode(), self.now_ns)
        received = b""
        while (end_ns := self.bus.next_arrival_ns()) is not None:
            self.now_ns = max(self.now_ns, end_ns)
            received += self.bus.read(self.now_ns)
        self.wait_s(0.01)
        return received

    def wait_s(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)
        self.bus.advance(self.now_ns)

    def horn_deg(self) -> float:
        return self.bus.motors.horn_deg(0, self.now_ns)

    def horn_deg_s(self) -> float:
        return self.bus.motors.horn_deg_s(0, self.now_ns)


# -- printed replies -----------------------------------------------------------------------------

STATUS_STATES = {
    1: State(),
    2: State(lines=("#5RDM500",)),
    3: State(lines=("#5AA1", "#5D9000")),
    4: State(lines=("#5WD20",), wait_s=1.0),
    5: State(lines=("#5AD1", "#5D200", "#5H", "#5WD200", "#5WD1"), wait_s=0.1),
    6: State(lines=("#5H",)),
    7: State(lines=("#5D300", "#5CLP100", "#5CLE1"), wait_s=1.0),
    8: State(lines=("#5D900",), wait_s=0.3, faults=STUCK),
    9: State(lines=("#5D900",), wait_s=1.0, faults=STUCK),
    10: State(lines=("#5D900",), wait_s=3.0, faults=STUCK),
}
CAUSE_STATES = {
    0: State(query="#5Q1"),
    1: State(lines=("#5D900",), wait_s=3.0, faults=STUCK, query="#5Q1"),
    2: State(lines=("#5D90",), wait_s=0.2, physics={"supply_v": 14.0}, query="#5Q1"),
    3: State(
        lines=("#5D90",),
        wait_s=0.5,
        faults=(Fault(kind=FaultKind.HOT, at_s=0.3, temperature_c=90.0),),
        query="#5Q1",
    ),
}
CAUSE_LINES = range(412, 416)
"""Lines of the LSS-PRO document where `*5Q0` to `*5Q3` are replies to `Q1`."""

MOVED = {"QD": "D", "QDT": "D", "QP": "P", "QWD": "WD", "QWR": "WR"}

DECISIONS = {
    (Family.LSS, 520): "a simulated servo is never in an unknown state",
    (Family.LSS_PRO, 393): "a simulated servo is never in an unknown state",
    (Family.LSS_PRO, 395): "needs RDM, which has no row in the tables of the document",
    (Family.LSS_PRO, 400): "needs limits, which have no row in the tables of the document",
}
"""Replies that the simulator never sends, with the reason."""

INSTEAD = {
    (Family.IO2, 56): (b"*209QD130\r", "the board works in whole degrees"),
    (Family.IO2, 185): (b"*205QA190\r", "the board clamps this sensor at 190 mm"),
}
"""Replies that differ from the printed one, with the reason."""

INPUTS = {
    "*203QA364": {203: 364},
    "*203QA50": {203: SENSORS[Suffix.GP2Y0A41SK0F].raw(50)},
    "*204QA100": {204: SENSORS[Suffix.GP2Y0A21YK0F].raw(100)},
    "*205QA150": {205: SENSORS[Suffix.GP2Y0A02YK0F].raw(150)},
}
"""Raw inputs of the pins for the printed replies."""

SIMPLE = {
    "QMS": lambda text: State(name=text),
    "QN": lambda text: State(spec={"answers": {"N": text}}),
    "QUC": lambda text: State(spec={"answers": {"UC": int(text)}}),
    "QFR": lambda text: State(spec={"answers": {"FR": int(text)}}),
    "QIX": lambda text: State(spec={"answers": {"IX": int(text)}}),
    "QIB": lambda text: State(spec={"answers": {"IB": int(text)}}),
    "QF": lambda text: State(firmware=int(text)),
    "QV": lambda text: State(physics={"supply_v": int(text) / 1000, "supply_ohm": 0.0}),
    "QT": lambda text: State(physics={"ambient_c": int(text) / 10}),
    "QC": lambda text: State(physics={"idle_ma": float(text)}),
    "QS": lambda text: State(lines=(f"#5WD{int(text) * 90 // 1000}",), wait_s=1.0),
    "QB": lambda text: State(lines=("#5CB" + text,)),
}


def state_of(family: Family, example) -> State:
    """Return the set-up that makes a servo send the printed reply."""
    keyword, text = example.keyword, example.data[1:-1].decode().partition(example.keyword)[2]
    address = example.servo_id
    if family is Family.IO2:
        if keyword == "QA":
            suffix = "" if example.printed.endswith("364") else str(address - 202)
            inputs = INPUTS[example.printed]
            return State(inputs=inputs, query=f"#{address}QA{suffix}")
        if keyword in ("QMS", "QB"):
            return State()
    if keyword == "Q":
        if family is Family.LSS_PRO:
            table = CAUSE_STATES if example.line in CAUSE_LINES else PRO_STATUS_STATES
            return table[int(text)]
        return STATUS_STATES[int(example.value)]
    if keyword == "QID":
        return State(query="#254QID", firmware=368 if family is Family.LSS else None)
    if keyword in SIMPLE:
        return SIMPLE[keyword](text)
    if keyword in MOVED:
        lines = (f"#{address}{MOVED[keyword]}{text}",) if text else ()
        return State(lines=lines, wait_s=8.0)
    row = FAMILY_TABLES[family].row(keyword)
    keyword_to_set = (row.actions or row.configs)[0]
    suffix = "1" if example.printed in ("*5QSR20", "*5QSR10") else ""
    if suffix:
        keyword_to_set = row.configs[0]
    return State(lines=(f"#{address}{keyword_to_set}{text}",), query=f"#{address}{keyword}{suffix}")


PRO_STATUS_STATES = {
    code: State(
        lines=tuple(line.replace("WD20", "WD2") for line in state.lines),
        wait_s=state.wait_s,
        faults=state.faults,
    )
    for code, state in STATUS_STATES.items()
} | {8: State(lines=("#5D9000",), wait_s=0.3, faults=STUCK),
     9: State(lines=("#5D9000",), wait_s=1.0, faults=STUCK),
     10: State(lines=("#5D9000",), wait_s=3.0, faults=STUCK),
     3: State(lines=("#5AA1", "#5D90000"))}  # fmt: skip

REPLIES = [
    (family, example)
    for family, examples in EXAMPLES.items()
    for example in examples
    if example.is_reply
]
REACHED = [each for each in REPLIES if (each[0], each[1].line) not in DECISIONS]


@pytest.mark.parametrize(
    ("family", "example"),
    [pytest.param(*each, id=f"{each[0]}-{each[1].line}-{each[1].printed}") for each in REACHED],
)
def test_a_simulated_servo_replies_as_the_document_prints(family, example):
    state = state_of(family, example)
    host = DocumentHost(family, example.servo_id if family is not Family.IO2 else 209, state)
    printed, _ = INSTEAD.get((family, example.line), (example.data, ""))
    assert host.query(state.query or f"#{example.servo_id}{example.keyword}") == printed


def test_every_printed_reply_is_checked_or_excluded_with_a_reason(capsys):
    lines = []
    for family in Family:
        total = sum(example.is_reply for example in EXAMPLES[family])
        checked = sum(each[0] is family for each in REACHED)
        decided = [line for known, line in DECISIONS if known is family]
        printed = {example.line for example in EXAMPLES[family] if example.is_reply}
        assert set(decided) <= printed
        assert checked + len(decided) == total > 0
        lines.append(f"{family}: {checked}/{total} printed replies, {len(decided)} excluded\n")
    with capsys.disabled():
        sys.stdout.write("\n" + "".join(lines))


# -- every keyword -------------------------------------------------------------------------------


def address_of(family: Family, row) -> int:
    if family is not Family.IO2:
        return 5
    ids = {Device.MASTER: 207, Device.ANALOG: 203}
    return ids.get(row.devices[0], 209) if row.devices else 209


def host_for(family: Family, **state) -> DocumentHost:
    return DocumentHost(family, 209 if family is Family.IO2 else 5, State(**state))


def other_value(row, default: int | None) -> int:
    """Return an allowed value that differs from the factory value."""
    if row.choices is not None:
        return next(value for value in sorted(row.choices) if value != default)
    for value in (30, 300, 600, 3, 1):
        if row.allows(value) and value != default:
            return value
    raise AssertionError(row)


def moved(host: DocumentHost, line: str, wait_s: float = 2.0) -> float:
    before_deg = host.horn_deg()
    host.send(line)
    host.wait_s(wait_s)
    return host.horn_deg() - before_deg


def pro(family: Family) -> bool:
    return family is Family.LSS_PRO


def check_limp(host: DocumentHost, family: Family, line: str) -> None:
    address = line[: line.index("L")]
    host.send(f"{address}D300")
    host.wait_s(1.0)
    host.send(line)
    host.wait_s(0.1)
    assert not host.bus.motors._drives.is_powered[0]


def check_halt(host: DocumentHost, family: Family, line: str) -> None:
    host.send("#5WD20")
    host.wait_s(1.0)
    assert abs(host.horn_deg_s()) > 1.0
    host.send(line)
    host.wait_s(0.5)
    assert abs(host.horn_deg_s()) < 0.01
    assert host.query("#5Q") == b"*5Q6\r"


def check_reset(host: DocumentHost, family: Family, line: str) -> None:
    address = line[: line.index("R")]
    query = f"{address}QLED"
    host.send(f"{address}LED3")
    assert host.query(query).endswith(b"QLED3\r")
    host.bus.write(f"{line}\r{query}\r".encode(), host.now_ns)
    host.wait_s(0.02)
    assert host.bus.read(host.now_ns) == b""
    host.wait_s(1.3)
    assert not host.query(query).endswith(b"QLED3\r")


def check_default(host: DocumentHost, family: Family, line: str) -> None:
    address = line[: line.index("D")]
    host.send(f"{address}CLED3")
    host.send(line)
    if family is not Family.IO2:
        host.send(f"{address}CONFIRM")
    host.wait_s(1.4)
    default = FAMILY_TABLES[family].row("QLED").default
    expected = b"QLED%d\r" % default
    if family is not Family.IO2:
        assert host.query(f"{address}QLED") == b""
        address = "#0"  # All values are reset, and the id is one of them.
    assert host.query(f"{address}QLED").endswith(expected)


def check_update(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line)
    host.send("#5CONFIRM")
    assert host.query("#5Q") == b""
    host.wait_s(1.4)
    assert host.query("#5Q") == b"*5Q1\r"


def check_confirm(host: DocumentHost, family: Family, line: str) -> None:
    host.send("#5CLED3")
    host.send(line)
    assert host.query("#5QLED") == b"*5QLED3\r"
    host.send("#5DEFAULT")
    host.send(line)
    host.wait_s(1.4)
    assert host.query("#5QLED") == b""
    assert host.query("#0QLED") not in (b"", b"*0QLED3\r")


def check_rc(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line + "1")
    host.send("#5RESET")
    host.wait_s(3.0)
    assert host.query("#5Q") == b""


def check_board_id(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line + "1")
    assert host.query("#1QMS") == b"*1QMSLSS-2IO-D9\r"
    assert host.query("#209QMS") == b""


def check_baud(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line + "9600")
    assert host.query("#207QB") == b""


def check_level(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line + "200")
    assert host.query("#203QA") == b"*203QA1023\r"


def check_receiver(host: DocumentHost, family: Family, line: str) -> None:
    host.send(line + "4")
    assert host.query("#203QA").startswith(b"*203QA,1500,")


def goes(value: str, wanted_deg):
    def check(host: DocumentHost, family: Family, line: str) -> None:
        wanted = wanted_deg(family) if callable(wanted_deg) else wanted_deg
        assert moved(host, line + value) == pytest.approx(wanted, abs=0.05)

    return check


def turns(value: str, wanted_deg_s):
    def check(host: DocumentHost, family: Family, line: str) -> None:
        host.send(line + value)
        host.wait_s(1.0)
        wanted = wanted_deg_s(family) if callable(wanted_deg_s) else wanted_deg_s
        assert host.horn_deg_s() == pytest.approx(wanted, abs=0.5)

    return check


EFFECTS = {
    "L": check_limp,
    "H": check_halt,
    "D": goes("900", lambda family: 9.0 if pro(family) else 90.0),
    "MD": goes("100", lambda family: 1.0 if pro(family) else 10.0),
    "P": goes("2000", lambda family: 51.2 if family is Family.IO2 else 45.0),
    "A": check_level,
    "CA": check_receiver,
    "M": goes("500", 45.0),
    "WD": turns("20", lambda family: 20.0 if pro(family) else 2.0),
    "WR": turns("3", 18.0),
    "RDM": turns("512", 300.0),
    "RESET": check_reset,
    "RS": check_reset,
    "DEFAULT": check_default,
    "UPDATE": check_update,
    "CONFIRM": check_confirm,
    "CRC": check_rc,
    "CID": check_board_id,
    "CB": check_baud,
}
"""Checks of keywords that no query can verify."""

KEYWORDS = [
    (family, keyword, form)
    for family, table in FAMILY_TABLES.items()
    for keyword, (form, _) in table.by_keyword.items()
]


def as_params(form_is_query: bool):
    return [
        pytest.param(family, keyword, id=f"{family}-{keyword}")
        for family, keyword, form in KEYWORDS
        if (form is Form.QUERY) is form_is_query
    ]


@pytest.mark.parametrize(("family", "keyword"), as_params(form_is_query=True))
def test_every_query_has_a_reply_in_all_its_forms(family, keyword):
    row = FAMILY_TABLES[family].row(keyword)
    address = address_of(family, row)
    host = host_for(family, inputs={203: 200} if keyword == "QA" else {})
    for suffix in (None, *(row.suffixes or {})):
        answer = host.query(f"#{address}{keyword}{'' if suffix is None else suffix}")
        (reply,) = ReplyParser().feed(answer)
        assert isinstance(reply, Reply)
        assert (reply.servo_id, reply.keyword) == (address, keyword)
        assert read_reply(family, reply, suffix=suffix) is not None
        if row.reply_shape is ReplyShape.INTEGER:
            assert isinstance(reply.value, int)


@pytest.mark.parametrize(("family", "keyword"), as_params(form_is_query=False))
def test_every_action_and_configuration_has_its_effect(family, keyword):
    form, row = FAMILY_TABLES[family].find(keyword)
    host = host_for(family)
    line = f"#{address_of(family, row)}{keyword}"
    is_checked_by_effect = not row.queries or keyword in ("D", "P", "WD", "WR", "RDM")
    if family is Family.IO2 and keyword in ("CID", "CB", "A", "CA"):
        is_checked_by_effect = True
    if is_checked_by_effect:
        EFFECTS[keyword](host, family, line)
        return
    value = other_value(row, row.default)
    query = f"#{address_of(family, row)}{row.queries[0]}"
    before = host.query(query)
    host.send(f"{line}{value}")
    assert host.query(query) == f"*{query[1:]}{value}\r".encode() != before
    if form is Form.CONFIG and row.suffixes and 1 in row.suffixes:
        assert host.query(f"{query}1") == f"*{query[1:]}{value}\r".encode()


def first_of(family: Family, lines: list[str], wait_s: float) -> float:
    host = host_for(family)
    for line in lines[:-1]:
        host.send(line)
    return moved(host, lines[-1], wait_s)


MODIFIER_EFFECTS = {
    "T": lambda family: (
        first_of(family, ["#5D3000T3000"], 1.0) < first_of(family, ["#5D3000"], 1.0)
    ),
    "S": lambda family: first_of(family, ["#5P2500S100"], 1.0) < first_of(family, ["#5P2500"], 1.0),
    "SD": lambda family: (
        first_of(family, ["#5D3000SD50"], 1.0) < first_of(family, ["#5D3000"], 1.0)
    ),
    "CH": lambda family: status_when_stuck("#5D900CH400") == b"*5Q6\r",
    "CL": lambda family: status_when_stuck("#5D900CL400") == b"*5Q1\r",
}


def status_when_stuck(line: str) -> bytes:
    host = DocumentHost(Family.LSS, 5, State(faults=STUCK))
    host.send(line)
    host.wait_s(1.0)
    return host.query("#5Q")


MODIFIERS = [(family, name) for family, table in FAMILY_TABLES.items() for name in table.modifiers]


@pytest.mark.parametrize(("family", "name"), MODIFIERS)
def test_every_modifier_has_its_effect(family, name):
    assert MODIFIER_EFFECTS[name](family)


def test_every_row_of_the_documents_is_checked(capsys):
    """The three tests above cover all keywords; each row of the documents has one of them."""
    checked = {(family, keyword) for family, keyword, _ in KEYWORDS} | set(MODIFIERS)
    lines = []
    for family, rows in ROWS.items():
        for row in rows:
            printed = f"{row.action} {row.query} {row.config}".split()
            assert printed
            for keyword in printed:
                assert (family, row.meant.get(keyword, keyword)) in checked
        assert len(rows) == DOCUMENT_ROW_COUNT[family]
        lines.append(f"{family}: {len(rows)}/{DOCUMENT_ROW_COUNT[family]} rows, ")
        lines.append(f"{sum(known is family for known, _ in checked)} keywords checked\n")
    with capsys.disabled():
        sys.stdout.write("\n" + "".join(lines))
