"""Messages: what is accepted, what is refused, and that the schema says the same."""

from __future__ import annotations

import math

import jsonschema
import msgspec
import pytest

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.message import Telemetry

OPERATIONS = [
    m.Go(id=1),
    m.Pause(id=2),
    m.Resume(),
    m.Rate(ratio=0.5),
    m.Seek(to=3.5),
    m.Seek(to="wave"),
    m.Stop(id=7),
    m.Estop(),
    m.Beat(),
    m.Follow(instant_ns=5, show_s=-3.5, rate=1.0, source="ltc", state="locked"),
    m.Follow(instant_ns=5, show_s=3.5, rate=0.0),
]
REFUSED = [
    "",
    "[]",
    "{}",
    '{"op": "fly"}',
    '{"op": "rate"}',
    '{"op": "rate", "ratio": 0}',
    '{"op": "rate", "ratio": 1.5}',
    '{"op": "rate", "ratio": "1"}',
    '{"op": "rate", "ratio": NaN}',
    '{"op": "seek", "to": -1}',
    '{"op": "seek", "to": ""}',
    '{"op": "stop", "now": true}',
    '{"op": "follow", "instant_ns": 5, "show_s": 1.0, "rate": -1.0}',
    '{"op": "follow", "instant_ns": 5, "show_s": 1e300, "rate": 1.0}',
    '{"op": "follow", "show_s": 1.0, "rate": 1.0}',
    '{"op": "stop", "id": -1}',
    '{"op": "stop", "id": 1' + " " * m.OPERATION_MAX_BYTES + "}",
    b"\xff\xfe",
]


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda o: o.op)
def test_an_operation_comes_back_from_its_json_and_fits_the_schema(operation):
    assert m.parse_operation(operation.to_json()) == operation
    jsonschema.validate(msgspec.to_builtins(operation), m.schema())


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_no_operation_is_refused_with_a_reason(text):
    with pytest.raises(InputError, match="operation"):
        m.parse_operation(text)


def test_the_schema_requires_what_tells_messages_apart():
    for message in ({"id": 1}, {"op": "fly"}, {"op": "rate", "ratio": 2}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(message, m.schema())


def test_telemetry_comes_back_from_its_bytes():
    sent = Telemetry(b"12345678", 61.25, 0.5, [(1.5, 2.5, math.nan), (-90.0, 0.25, -89.5)])
    read = Telemetry.from_bytes(sent.to_bytes())
    assert (read.plan, read.show_s, read.rate) == (b"12345678", 61.25, 0.5)
    assert read.angles_deg[1] == (-90.0, 0.25, -89.5)
    assert math.isnan(read.angles_deg[0][2])
    with pytest.raises(InputError, match="version 9"):
        Telemetry.from_bytes(b"\x09" + sent.to_bytes()[1:])
