from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.system import real_time as subject
from lss_motion.system.real_time import PRIORITY, SLICE_NS, prompt_waits, real_time

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_setscheduler"), reason="this system has no such call"
)


class System:
    """Records the requests, and permits them or not."""

    def __init__(self, *, is_kind):
        self.calls = []
        self._is_kind = is_kind

    def sched_setscheduler(self, pid, policy, parameters):
        self.calls.append((policy, parameters.sched_priority))
        if not self._is_kind:
            raise PermissionError

    def mlockall(self, flags):
        self.calls.append("lock")
        return 0 if self._is_kind else -1

    def munlockall(self):
        self.calls.append("unlock")


@pytest.fixture
def system(request, monkeypatch):
    system = System(is_kind=request.param)
    monkeypatch.setattr(os, "sched_setscheduler", system.sched_setscheduler)
    monkeypatch.setattr(subject, "_libc", lambda: system)
    return system


@pytest.mark.parametrize("system", [True], indirect=True)
def test_granted_privileges_are_given_back(system):
    before = (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority)
    with real_time() as refused:
        assert refused == []
        assert system.calls == [(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY), "lock"]
    assert system.calls[2:] == ["unlock", before]


@pytest.mark.parametrize("system", [False], indirect=True)
def test_a_refusal_is_reported_with_a_remedy(system):
    with real_time() as refused:
        priority, memory = refused
    assert f"rtprio {PRIORITY}` to /etc/security/limits.conf" in priority
    assert "memlock unlimited` to /etc/security/limits.conf" in memory
    assert len(system.calls) == 2, "what was not granted is not given back"


@pytest.mark.parametrize("system", [True], indirect=True)
def test_nothing_is_requested_that_is_not_wanted(system):
    with real_time(is_wanted=False) as refused:
        assert refused == []
    assert system.calls == []


def slice_ns():
    """Return how long this process runs at a time, as Linux reports since 6.12."""
    path = Path("/proc/self/sched")
    text = path.read_text(encoding="ascii") if path.exists() else ""
    match = re.search(r"^se\.slice\s*:\s*(\d+)", text, re.MULTILINE)
    return None if match is None else int(match[1])


@pytest.mark.skipif(slice_ns() is None, reason="this system has no slices, or does not tell them")
def test_a_player_requests_a_short_slice_and_gives_it_back():
    before_ns = slice_ns()
    assert before_ns > SLICE_NS
    with prompt_waits():
        assert slice_ns() == SLICE_NS
    assert slice_ns() == before_ns


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="this system has no such priority")
def test_a_helper_never_interrupts_the_player():
    said = (
        "import os; from lss_motion.system.real_time import lower_priority; before = os.nice(0); "
        "lower_priority(); print(os.sched_getscheduler(0) == os.SCHED_BATCH, os.nice(0) > before)"
    )
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True"]
