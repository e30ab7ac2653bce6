"""Keys and signals, as a run takes them."""

from __future__ import annotations

import signal

import pytest

from lss_motion.cli.terminal import Inputs


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
