"""What an adapter returns of what was sent is taken out; replies are not."""

from __future__ import annotations

import pytest

from lss_motion.playing.discovery import BusListening, DiscoveryStep
from lss_motion.playing.player.echo import EchoFilter
from lss_motion.playing.player.query_tracker import SerialLine
from lss_motion.robot.model import Bus

SENT = (b"\r", b"#1QD\r", b"#2D-300T250\r", b"#254QID\r")
ECHOED = b"\r#1QD\r*1QD5\r#2D-300T250\r#254QID\r*QID1\r*2QD-7\r"
LEFT = b"*1QD5\r*QID1\r*2QD-7\r"


@pytest.mark.parametrize("size", range(1, len(ECHOED) + 1))
def test_an_echo_in_pieces_of_any_size_is_taken_out(size):
    echo = EchoFilter()
    for line in SENT:
        echo.note_sent(line)
    pieces = (ECHOED[at : at + size] for at in range(0, len(ECHOED), size))
    assert b"".join(map(echo.without_echo, pieces)) == LEFT
    assert echo.count == 3


@pytest.mark.parametrize("data", [b"*1QD5\r", b"\xff\x00\r", b"#3QD\r", b"#\r*1QD5\r", b"\r\r"])
def test_what_was_not_sent_stays(data):
    echo = EchoFilter()
    echo.note_sent(b"#1QD\r")
    assert (echo.without_echo(data), echo.count) == (data, 0)


def test_a_damaged_echo_stays_and_hides_no_reply():
    echo = EchoFilter()
    echo.note_sent(b"#1QD\r")
    assert echo.without_echo(b"#1QX\r*1QD5\r") + echo.without_echo(b"#1Q") == b"#1QX\r*1QD5\r"
    assert echo.without_echo(b"*2QD1\r") == b"#1Q*2QD1\r"


def test_an_echo_is_no_garbage_on_a_line():
    line = SerialLine(Bus(name="main", port="sim://", baud_bps=115200, firmware=370))
    line.send(b"#1QD\r", 0)
    replies = [reply for reply, _ in line.receive(b"#1QD\r*1QD5\r", 1_000_000)]
    assert [reply.value for reply in replies] == [5]
    assert (line.garbage, line.echo.count) == (0, 1)


def test_a_scan_hears_nothing_of_its_echo():
    listening = BusListening("main", [DiscoveryStep(b"\r", 0), DiscoveryStep(b"#254QID\r", 1_000)])
    for now_ns in (0, 1):
        for data in listening.data_to_send(now_ns).values():
            listening.receive_data("main", data, now_ns)
    assert (listening.received, listening.echo.count) == ([b"", b""], 1)
