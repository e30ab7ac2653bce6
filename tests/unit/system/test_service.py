"""The unit that systemd starts, and what a running stage tells it."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from lss_motion.system.service import MARK, Notifier, ServiceUnit, quoted, unit_text

UNIT = ServiceUnit(
    stage="hall 100 %",
    command=("/usr/bin/env", "python3", "/home/me/my show/hall's.yaml", "--wait-port"),
    folder=Path("/tmp"),
    user="daemon",
    groups=("dialout",),
    is_networked=True,
    variables={"A": "b c"},
)


def test_words_are_quoted_as_systemd_reads_them():
    assert quoted("plain-word") == "plain-word"
    assert quoted("a b") == '"a b"'
    assert quoted("50%$HOME\\") == '"50%%$$HOME\\\\"'
    assert quoted("") == '""'
    with pytest.raises(ValueError, match="control"):
        quoted("a\nb")


def test_a_unit_lets_the_player_brake_and_tries_again():
    text = unit_text(UNIT)
    assert text.startswith(MARK)
    lines = text.splitlines()
    assert 'ExecStart=/usr/bin/env python3 "/home/me/my show/hall\'s.yaml" --wait-port' in lines
    assert "Description=lss_motion: stage hall 100 %%" in lines
    for line in ("Type=notify", "WatchdogSignal=SIGTERM", "User=daemon", 'Environment="A=b c"'):
        assert line in lines
    assert "After=network-online.target" in lines


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="sudo apt install systemd")
def test_systemd_accepts_the_unit(tmp_path):
    path = tmp_path / "lss-hall.service"
    path.write_text(unit_text(UNIT))
    words = ["systemd-analyze", "verify", "--man=no", str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert [line for line in done.stderr.splitlines() if "lss-hall" in line] == []
    path.write_text(unit_text(UNIT).replace("Restart=", "Restart=sometimes"))
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "lss-hall" in done.stderr


def test_a_notifier_tells_its_state_to_the_socket(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.bind(str(tmp_path / "notify"))
        own.settimeout(1.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "30000000")
        monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
        notifier = Notifier.from_environment()
        assert "NOTIFY_SOCKET" not in os.environ, "no child may answer for this process"
        assert notifier.watchdog_s == 30.0
        notifier.ready()
        notifier.status("plays\nhello")
        notifier.status("plays\nhello")
        notifier.beat()
        notifier.beat()
        notifier.stopping()
        told = [own.recv(100) for _ in range(4)]
    assert told == [b"READY=1", b"STATUS=plays hello", b"WATCHDOG=1", b"STOPPING=1"]
    notifier.ready()  # The socket is gone.
    Notifier(None, None).ready()
