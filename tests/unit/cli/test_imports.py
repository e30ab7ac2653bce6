"""What the programs import for `--help`: an answer at once needs no numbers and no port."""

import subprocess
import sys

import pytest

HEAVY = ("numpy", "scipy", "toppra", "pydantic", "yaml", "serial", "rich", "matplotlib")


@pytest.mark.parametrize("program", ["play", "main"])
def test_help_imports_no_heavy_library(program) -> None:
    code = (
        "import sys\n"
        f"from lss_motion.cli.start import {program} as run\n"
        "try:\n    run()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', *(name for name in {HEAVY} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True
    )
    assert "usage:" in done.stdout
    assert done.stdout.splitlines()[-1].strip() == "loaded:"
