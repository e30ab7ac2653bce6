"""The table of the computers of a stage, in a real browser, against two served figures."""

from __future__ import annotations

import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from tests.network import free_port
from tests.programs import ProgramBeside, command

pytest.importorskip("zenoh", reason="needs the extra `network`")

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"


def row(name, part):
    return f"document.querySelector('[data-host={name}] {part}')?.textContent"


@pytest.fixture
def duet(tmp_path, monkeypatch):
    """The duet of the examples on a port of its own, with its second figure served."""
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "cache"))
    for name in ("robots", "parts", "stages"):
        shutil.copytree(EXAMPLES / name, tmp_path / name)
    port = free_port()
    path = tmp_path / "stages" / "duet.yaml"
    path.write_text(path.read_text().replace("127.0.0.1:7447", f"127.0.0.1:{port}"))
    words = command("serve", path, "--figure", "right")
    with ProgramBeside(words, stdin=subprocess.PIPE) as right:
        yield path, right
        right.send_signal(signal.SIGCONT)
        right.send_signal(signal.SIGINT)
        right.ended()


def test_the_page_shows_every_computer_a_lost_one_and_one_stop_for_all(studio, opened, duet):
    path, right = duet
    with studio(path, "--figure", "left", "--go", command="serve") as own, opened(own) as page:
        page.wait(f"{row('left', '.host-state')} === 'playing'")
        page.wait(f"{row('right', '.host-state')} === 'playing'")
        clocks = [page.run(row(name, "td:nth-of-type(2)")) for name in ("left", "right")]
        assert clocks[0] == "its own"
        bound_ms = float(clocks[1].removeprefix("± ").partition(" ms")[0])
        assert 0.0 < bound_ms < 10.0
        right.send_signal(signal.SIGSTOP)
        page.wait(f"{row('right', '.host-state')} === '▲ lost'")
        assert page.run("document.querySelector('[data-host=right]').className") == "host-bad"
        assert "nothing arrives" in page.run(row("right", ".host-text"))
        right.send_signal(signal.SIGCONT)
        page.wait(f"{row('right', '.host-state')} === 'playing'")
        stops = [name for role, name in page.names() if role == "button" and "STOP" in name]
        assert len(stops) == 2, stops  # And the E-STOP.
        page.key("Escape")
        page.wait("document.body.dataset.latched === 'true'")
        page.wait("document.querySelector('.hosts') === null")
    assert "the conductor stopped all" in right.said
