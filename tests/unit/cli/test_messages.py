"""What reaches the screen reaches every screen."""

from __future__ import annotations

import os
import subprocess
import sys


def test_a_terminal_without_superscripts_gets_a_question_mark_and_no_traceback():
    command = [sys.executable, "-m", "lss_motion.cli.main", "reference", "LSS"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "deg/s?" in done.stdout
