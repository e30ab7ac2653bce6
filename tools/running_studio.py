"""`lss-motion studio` as a process, as a user starts it: for tests, bench and pictures."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator

START: Final = "from lss_motion.cli.start import main; raise SystemExit(main())"
START_S: Final = 60.0
END_S: Final = 20.0
"""The longest times that its start and its end may take."""


class Studio:
    """A running studio: its addresses, token and processes."""

    def __init__(self, file: Path, *options: str, command: str = "studio") -> None:
        """Start it; raises `OSError` if it ends at once. `command` may be `serve`, for a stage."""
        words = [sys.executable, "-c", START, command, str(file), "--json"]
        words += ["--no-browser"] if command == "studio" else []
        # What a user has: Python, and no Node.
        self.process = subprocess.Popen(
            [*words, *options],
            stdout=subprocess.PIPE,
            env=os.environ | {"PATH": str(Path(sys.executable).parent)},
        )
        try:
            told = json.loads(self._read_told())
        except (OSError, TimeoutError):
            self.process.kill()
            self.close()
            raise
        self.url: str = told["url"]
        self.token: str = told["token"]
        self.stop_origin: str = told["stop"]
        self.origin: str = told["addresses"][0]

    def _read_told(self) -> bytes:
        """Return what it prints at its start, one JSON object."""
        assert self.process.stdout is not None
        stdout_fd = self.process.stdout.fileno()
        told, end_s = b"", time.monotonic() + START_S
        while not told.endswith(b"}\n"):
            left_s = max(end_s - time.monotonic(), 0.0)
            if not select.select([stdout_fd], [], [], left_s)[0]:
                raise TimeoutError(f"the studio has not begun after {START_S:g} s")
            if not (data := os.read(stdout_fd, 65536)):
                raise OSError("the studio has ended")
            told += data
        return told

    @property
    def key(self) -> dict[str, str]:
        """The header by which a client without a browser has the role `edit`."""
        return {"Authorization": f"Bearer {self.token}"}

    @property
    def socket_url(self) -> str:
        return self.origin.replace("http", "ws", 1) + "/ws"

    def parts(self) -> dict[str, int]:
        """Return the processes that it has started, by the module that each runs (Linux)."""
        found = {}
        for place in Path("/proc").glob("[0-9]*"):
            try:
                words = (place / "cmdline").read_text().split("\0")
                parent = (place / "stat").read_text().rpartition(")")[2].split()[1]
            except OSError:
                continue
            if int(parent) == self.process.pid and "-c" in words:
                found[words[words.index("-c") + 3]] = int(place.name)
        return found

    def close(self) -> None:
        """End it as Ctrl-C does; its parts end with it."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(signal.SIGINT)
        assert self.process.stdout is not None
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(END_S)
            raise
        finally:
            self.process.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def running(file: Path, *options: str, command: str = "studio") -> Iterator[Studio]:
    """Run the studio for a file."""
    with Studio(file, *options, command=command) as studio:
        yield studio
