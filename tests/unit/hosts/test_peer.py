"""Two computers on the loopback, over zenoh itself."""

import socket
import time

import pytest

pytest.importorskip("zenoh", reason="needs the extra `network`")

from lss_motion.errors import BusError
from lss_motion.stage.hosts.messages import ClockAnswer, ClockQuestion, hash_of, packed, parse
from lss_motion.stage.hosts.peer import NetworkSettings, Peer
from tests.network import free_port


def settings(name, port, **changes):
    plain = {"stage": "hall", "figure": name, "conductor": "left", "figures": ["left", "right"]}
    return NetworkSettings(**{**plain, "address": f"127.0.0.1:{port}", **changes})


def first(peer, what, seconds=5.0, key=None):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for arrival in peer.take(0.05):
            if arrival.what == what and key in (None, arrival.key):
                return arrival
    return None


def sent(sender, key, content, receiver):
    """Send until it arrives: where the network is busy, a message is dropped."""
    for _ in range(20):
        sender.send(key, content)
        if (arrival := first(receiver, "message", 0.5)) is not None:
            return arrival
    return None


@pytest.fixture
def pair():
    port = free_port()
    with Peer(settings("left", port), clock_id="a" * 16) as left:
        left.answer_clock()
        left.subscribe("figure/*/status")
        left.watch("figure/*/alive")
        with Peer(settings("right", port)) as right:
            right.announce("figure/right/alive")
            right.subscribe("clock/right")
            right.subscribe("beat")
            assert first(left, "alive").key == "figure/right/alive"
            yield left, right


def test_messages_tokens_content_and_clock(pair):
    left, right = pair
    arrival = sent(right, "figure/right/status", b"{}", left)
    assert (arrival.key, arrival.content) == ("figure/right/status", b"{}")

    asked_ns = time.monotonic_ns()
    question = packed(ClockQuestion(asked_ns=asked_ns))
    arrival = sent(right, "figure/right/clock", question, right)
    answer = parse(ClockAnswer, arrival.content)
    assert asked_ns == answer.asked_ns
    assert asked_ns <= answer.received_ns <= answer.answered_ns <= arrival.at_ns
    assert answer.instance == "a" * 16

    plan = b"plan" * 300_000
    left.serve({hash_of(plan): plan, hash_of(b"asked for"): b"something else"}.get)
    arrival = None
    while arrival is None or arrival.what == "no content":  # Until it is known who serves it.
        right.fetch(hash_of(plan))
        (arrival,) = right.take(5.0)
    assert (arrival.what, arrival.content) == ("content", plan)
    right.fetch(hash_of(b"asked for"))
    assert first(right, "no content").content == b""

    right.send("figure/right/status", b"x" * 20_000)  # Longer than any message of ours.
    right.send("figure/right/clock", b"{")
    assert sent(right, "figure/right/status", b"after", left).content == b"after"

    right.close()
    assert first(left, "gone").key == "figure/right/alive"


def test_an_address_that_is_taken_is_an_error_for_people():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(BusError, match="stage 'hall'"):
            Peer(settings("left", other.getsockname()[1]))


def test_a_figure_may_start_before_its_conductor():
    port = free_port()
    with Peer(settings("right", port)) as right:
        right.announce("figure/right/alive")
        with Peer(settings("left", port)) as left:
            left.watch("figure/*/alive")
            assert first(left, "alive") is not None


def keyed(pair_of_folders, names=("left", "right")):
    from lss_motion.stage.hosts.peer import make_keys

    for folder in pair_of_folders:
        make_keys("hall", names, folder)


def test_keys_let_in_who_has_them_and_speak_for_their_own_name_only(tmp_path):
    pytest.importorskip("cryptography")
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    keyed([ours, theirs], ("left", "right", "middle"))
    port, names = free_port(), ["left", "right", "middle"]
    with Peer(settings("left", port, keys=ours, figures=names)) as left:
        left.subscribe("figure/*/status")
        left.watch("figure/*/alive")
        with (
            Peer(settings("right", port, keys=ours, figures=names)) as right,
            Peer(settings("middle", port, keys=theirs, figures=names)) as middle,
        ):
            for peer, name in ((right, "right"), (middle, "middle")):
                peer.announce(f"figure/{name}/alive")
                peer.subscribe("beat")
            assert first(left, "alive").key == "figure/right/alive"
            for _ in range(5):
                right.send("figure/middle/status", b"a lie")
                right.send("beat", b"a lie")
                middle.send("figure/middle/status", b"wrong keys")
                right.send("figure/right/status", b"the truth")
                left.send("beat", b"for right")
                time.sleep(0.05)
            said = {arrival.content for arrival in left.take(0.3) if arrival.what == "message"}
            assert said == {b"the truth"}
            assert b"for right" in {arrival.content for arrival in right.take(0.3)}
            assert first(middle, "message", 0.3) is None
