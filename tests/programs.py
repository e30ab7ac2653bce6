"""A program that runs beside a test: what it prints, its keys, and a limit for each wait."""

from __future__ import annotations

import codecs
import contextlib
import os
import pty
import re
import select
import subprocess
import sys
import threading

from tests.swing import WAIT_S

LOOK_S = 0.1
"""A reader sees within so long that it is to end."""

IN_FRONT = """
import os, sys
os.setsid()
os.close(os.open(os.ttyname(0), os.O_RDWR))
from lss_motion.cli.start import main
sys.exit(main())
"""
"""Runs `lss-motion` with the terminal as its own, as a shell's job in the foreground has it."""


def command(*words):
    """Return the command line of `lss-motion`."""
    return [sys.executable, "-m", "lss_motion.cli.start", *map(str, words)]


def terminal_command(*words):
    """Return the command line of `lss-motion` as the job in the foreground of its terminal."""
    return [sys.executable, "-c", IN_FRONT, *map(str, words)]


class ProgramBeside(subprocess.Popen):
    """A program that is killed at the end of its block; no wait for it is without a limit.

    `said` is what it has printed, `errors` what it has printed to the standard error. `keys`: its
    standard input is a terminal; `screen`: its outputs go to that terminal, too. `merged`: its
    errors are in `said`.
    """

    def __init__(self, command, *, keys=False, screen=False, merged=False, **options):
        self._terminal_fd, theirs = pty.openpty() if keys else (None, subprocess.DEVNULL)
        streams = {"stdin": theirs, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        if merged:
            streams["stderr"] = subprocess.STDOUT
        if screen:
            streams["stdout"] = streams["stderr"] = theirs
        super().__init__(command, **{**streams, **options})
        self.said, self.errors, self._seen, self._read_names = "", "", 0, set()
        if keys:
            os.close(theirs)
        said_fd = self._terminal_fd if screen else self.stdout.fileno()
        sources = {"said": said_fd, **({"errors": self.stderr.fileno()} if self.stderr else {})}
        self._is_over, self._news = threading.Event(), threading.Condition()
        self._readers = [
            threading.Thread(target=self._read, args=source, daemon=True)
            for source in sources.items()
        ]
        for reader in self._readers:
            reader.start()

    def _read(self, name, fileno):
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        with contextlib.suppress(OSError):  # Linux: nobody has the terminal open any more.
            while not self._is_over.is_set():
                if select.select([fileno], [], [], LOOK_S)[0]:
                    if not (data := os.read(fileno, 65536)):
                        break
                    with self._news:
                        setattr(self, name, getattr(self, name) + decoder.decode(data))
                        self._news.notify_all()
        with self._news:
            self._read_names.add(name)
            self._news.notify_all()

    def wait_for(self, pattern):
        """Wait until it prints what matches, behind what the last call waited for; return that.

        What is returned begins where the last call ended.
        """

        def found():
            return re.compile(pattern, re.MULTILINE).search(self.said, self._seen)

        begin = self._seen
        with self._news:
            self._news.wait_for(lambda: found() or "said" in self._read_names, WAIT_S)
        match = found()
        assert match, f"it never said {pattern!r}: {self.said[-2000:]}{self.errors}"
        self._seen = match.end()
        return self.said[begin : self._seen]

    def wait_for_all(self, *texts):
        """Wait until it has printed all these texts, in any order."""
        for text in texts:
            self._seen = 0
            self.wait_for(re.escape(text))

    def press(self, keys):
        """Press keys at its terminal."""
        os.write(self._terminal_fd, keys.encode())

    def hang_up(self):
        """Close its terminal, as a window that is closed does; nothing more is read."""
        self._end_reading()
        os.close(self._terminal_fd)
        self._terminal_fd = None

    def ended(self, wait_s=WAIT_S):
        """Wait until it has ended and all that it has printed is read; return its exit code."""
        try:
            code = self.wait(wait_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it did not end: {self.said[-2000:]}{self.errors}") from None
        for reader in self._readers:
            reader.join(WAIT_S)
            assert not reader.is_alive(), "a process that it has started still runs"
        return code

    def _end_reading(self):
        self._is_over.set()
        for reader in self._readers:
            reader.join(WAIT_S)

    def __exit__(self, *_):
        self.kill()
        self.wait(WAIT_S)
        if self._terminal_fd is not None:
            self.hang_up()
        self._end_reading()
        for stream in (self.stdin, self.stdout, self.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
