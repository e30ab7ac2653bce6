"""What every test may rely on: the same examples each time, and nothing of the user's touched."""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import HealthCheck, settings

from lss_motion.files import cache

settings.register_profile(
    "many",
    deadline=None,
    derandomize=True,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("quick", parent=settings.get_profile("many"), max_examples=12)
settings.register_profile(
    "search", parent=settings.get_profile("many"), derandomize=False, max_examples=2000
)
settings.load_profile("quick")  # Another one: pytest --hypothesis-profile=many


# Tests that are started in the background have these ignored, here and in every child.
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep plans and answers in folders of the test run, not in those of the user.

    All workers share plans and shows, and the key of these: an entry is written as a whole, so it
    can be read at any time.
    """
    run = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        run = run.parent
    os.environ["LSS_MOTION_CACHE_DIR"] = str(run / "plans")
    state = tmp_path_factory.mktemp("state")
    (state / cache.KEY_NAME).write_bytes(bytes(cache.KEY_BYTES))
    (state / cache.KEY_NAME).chmod(0o600)
    os.environ["LSS_MOTION_STATE_DIR"] = str(state)


def pytest_xdist_auto_num_workers() -> int:
    """Run two workers for each core: tests with real clocks and browsers wait most of their time.

    Measured on two cores: the workers of a whole run need 0.4 s of processor time a second.
    """
    return 2 * (os.cpu_count() or 1)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden", action="store_true", help="write the files of tests/golden anew"
    )
