"""Keys and signals, as a run takes them."""

from __future__ import annotations

import os
import signal

import pytest

from lss_motion.cli import terminal
from lss_motion.cli.terminal import LOOK_S, Inputs, Terminal


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT], ids=str
)
def test_what_asks_to_end_is_taken_once_and_named(number):
    before = signal.getsignal(number)
    with Inputs() as inputs:
        signal.raise_signal(number)
        assert inputs.take() == (1, "")
        assert inputs.take() == (0, "")
        assert inputs.signal_number == number
    assert signal.getsignal(number) == before


def test_a_terminal_that_is_closed_asks_once_however_often_it_is_said():
    with Inputs() as inputs:
        signal.raise_signal(signal.SIGHUP)
        assert inputs.take() == (1, "")
        signal.raise_signal(signal.SIGHUP)
        assert inputs.take() == (0, "")
        signal.raise_signal(signal.SIGTERM)
        assert inputs.take() == (1, "")


def test_who_was_started_to_outlive_the_terminal_does():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Inputs() as inputs:
            signal.raise_signal(signal.SIGHUP)
            assert inputs.take() == (0, "")
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_run_that_takes_no_signals_can_be_ended_all_the_same():
    with Inputs():
        for _ in range(5):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("is_virtual", [False, True], ids=["real time", "virtual time"])
def test_in_virtual_time_keys_are_looked_for_now_and_then_and_signals_always(
    monkeypatch, is_virtual
):
    now_s = [100.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s[0])
    keys, keyboard = os.pipe()
    with Inputs(is_virtual=is_virtual) as inputs:
        inputs._keys_fd = keys
        os.write(keyboard, b"+")
        assert inputs.take() == (0, "+")
        os.write(keyboard, b"q")
        now_s[0] += 0.9 * LOOK_S
        assert inputs.take() == (0, "" if is_virtual else "q")
        now_s[0] += 0.2 * LOOK_S
        assert inputs.take() == (0, "q" if is_virtual else "")
        signal.raise_signal(signal.SIGINT)
        assert inputs.take() == (1, "")
    for end in (keys, keyboard):
        os.close(end)


class Steered:
    """Notes the orders of a terminal."""

    def __init__(self):
        self.orders = []

    def stop(self, now_ns):
        self.orders.append("stop")

    def set_rate(self, rate, now_ns):
        self.orders.append(rate)


def test_a_stop_passes_all_keys_that_were_typed_before_it():
    keys, keyboard = os.pipe()
    steered = Steered()
    with Terminal() as typed:
        typed._keys_fd = keys
        os.write(keyboard, b" " * 5000 + b"qq" + b" " * 100)
        typed.act(steered, 0)
        assert steered.orders == ["stop", "stop"], "a second one stops at once"
        os.write(keyboard, b" ")
        typed.act(steered, 0)
        assert steered.orders[2:] == [0.0]
    for end in (keys, keyboard):
        os.close(end)
