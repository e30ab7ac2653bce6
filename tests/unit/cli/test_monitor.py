"""`lss-motion monitor` with a table that cannot be written."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_INPUT
from lss_motion.playing import connection
from lss_motion.system.clock import VirtualClock

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"
FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="a device of Linux that is always full")
def test_a_full_disk_is_a_warning_and_the_monitor_goes_on(capsys, monkeypatch):
    made = partial(connection.connect, clock=VirtualClock())
    monkeypatch.setattr(connection, "connect", made)
    code = main(["monitor", str(ARM), "--csv", str(FULL), "--for", "5", "--every", "1"])
    out, errors = capsys.readouterr()
    assert code == EXIT_INPUT
    assert errors == "warning: /dev/full: the table is not complete: No space left on device\n"
    assert out.count("shoulder") >= 4, "lines of every second"
