"""Each package that hangs on the core can be removed: the rest still plays a show."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tables import first_quick

ROOT = Path(__file__).parents[2]

REMOVED = {
    "interchange": ("exchange", "by_hand"),
    "maintenance": ("by_hand", "configure", "field_test", "identify", "monitor", "scan", "send"),
    "sound": ("beats", "exchange"),
    "stage": ("doctor", "serving", "stages"),
    "studio": ("serving",),
}
"""The commands that go with each package."""

ALSO = {"stage": ("studio",)}
"""The packages that need it."""


@pytest.mark.parametrize("package", first_quick(REMOVED))
def test_the_core_plays_without(package, tmp_path):
    copy = tmp_path / "site" / "lss_motion"
    shutil.copytree(ROOT / "lss_motion", copy, ignore=shutil.ignore_patterns("__pycache__"))
    for name in (package, *ALSO.get(package, ())):
        shutil.rmtree(copy / name)
    for name in REMOVED[package]:
        (copy / "cli" / f"{name}.py").unlink()
    words = [ROOT / "sequences" / "wave.yaml", "--virtual", "--report", tmp_path / "report.json"]
    done = subprocess.run(
        [sys.executable, "-m", "lss_motion.cli.start", "play", *words],
        env={**os.environ, "PYTHONPATH": str(copy.parent), "LSS_MOTION_CACHE_DIR": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert '"outcome": "finished"' in (tmp_path / "report.json").read_text()
