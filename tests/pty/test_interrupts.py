"""Every command with a port, interrupted: `tools/campaign interrupts` plays all combinations."""

from __future__ import annotations

import pytest
from campaign.interrupts import AFTER_LINES, COMMANDS, SIGNALS, play

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


def seed_of(command, number, after):
    """Return the seed of a combination."""
    return command + len(COMMANDS) * (number + len(SIGNALS) * after)


@pytest.mark.parametrize("command", range(len(COMMANDS)), ids=COMMANDS)
def test_an_interrupted_command_leaves_all_as_it_must_be(command):
    """Each with another signal, at another instant."""
    seed = seed_of(command, command % len(SIGNALS), 3 * command % len(AFTER_LINES))
    assert play(seed, None).broken == ()
