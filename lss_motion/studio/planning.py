"""The server's end of the planner process: the latest request wins.

Requests are sent at once; the planner takes the newest that has arrived. Trials of edits are sent
one at a time, while no request waits. One that is busy for
`PATIENCE_S` with a request that is no longer wanted is killed and started again: its answer would
only delay the one that is. A planner that stands still or is killed delays nothing else.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.studio.planner import (
    EditTrial,
    PlannerReply,
    Request,
    SpliceRequest,
    SpliceResult,
    TrialResult,
)
from lss_motion.system.process import ChildProcess

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE_S: Final = 2.0
"""Starting a planner takes a second of processor time (measured: 0.9 s)."""
OUTBOX_MAX_BYTES: Final = 1 << 27
"""Requests for a planner that is busy, with the texts of edited files. One that does not read them
is given up after `PATIENCE_S`. Chosen: eight of the largest files."""
FAILURES_MAX: Final = 2
"""A request at which the planner ends so often is not tried again."""
DIED: Final = (
    "the planner process has ended while it worked on this file; save the file to try again"
)


class Planner:
    """The planner process. `on_reply` gets the reply to the newest request, and no other.

    `on_trial` gets a result for every trial.
    """

    def __init__(
        self,
        on_reply: Callable[[PlannerReply], None],
        on_trial: Callable[[TrialResult], None] = lambda _: None,
        on_splice: Callable[[SpliceResult], None] = lambda _: None,
    ) -> None:
        self._on_reply, self._on_trial, self._on_splice = on_reply, on_trial, on_splice
        self._splices: set[int] = set()
        """The numbers of the splices that are not answered yet."""
        self._process: ChildProcess[PlannerReply | TrialResult | SpliceResult] | None = None
        self._trial: EditTrial | None = None
        """The newest, until it is answered."""
        self._trying: int | None = None
        """The number of the trial that the process works on."""
        self._wanted: Request | None = None
        """The newest request, until it is answered."""
        self._number = self._failures = 0
        self._impatience: asyncio.TimerHandle | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a request has no answer yet."""
        return self._wanted is not None

    @property
    def pid(self) -> int | None:
        """The planner process, where it runs."""
        return None if self._process is None else self._process.pid

    def ask(self, request: Request) -> None:
        """Plan this; answers to earlier requests, and trials, are dropped."""
        self._drop_trial()
        is_stale = self._wanted is not None
        self._number += 1
        self._failures = 0
        self._wanted = replace(request, number=self._number)
        self._send()
        if is_stale and self._impatience is None:
            loop = asyncio.get_running_loop()
            self._impatience = loop.call_later(PATIENCE_S, self._lose_patience)

    def try_edit(self, trial: EditTrial) -> None:
        """Try an edit; one that waits is dropped."""
        self._drop_trial()
        self._trial = trial
        self._send_trial()

    def splice(self, request: SpliceRequest) -> None:
        """Find how a show that plays goes on as the one that was planned last."""
        self._splices.add(request.number)
        if self._process is None:
            self._lose_splices()
            return
        self._process.send_object(request)
        self._flush()

    def _lose_splices(self) -> None:
        lost, self._splices = self._splices, set()
        for number in lost:
            self._on_splice(SpliceResult(number=number, problem="the planner has ended; try again"))

    def close(self) -> None:
        """End the planner process."""
        self._wanted = None
        self._end()

    def _send(self) -> None:
        if self._process is None:
            self._process = ChildProcess(
                "lss_motion.studio.planner", outbox_max_bytes=OUTBOX_MAX_BYTES
            )
            asyncio.get_running_loop().add_reader(self._process.fileno(), self._read)
        self._process.send_object(self._wanted)
        self._flush()

    def _flush(self) -> None:
        """Give the socket what it takes, and the rest when it takes more."""
        assert self._process is not None
        pipe, loop = self._process.pipe, asyncio.get_running_loop()
        pipe.flush()
        loop.remove_writer(pipe.fileno())
        if pipe.is_full:
            loop.add_writer(pipe.fileno(), self._flush)

    def _send_trial(self) -> None:
        """Send the newest trial, if the process is free for it."""
        if self._trial is None or self._wanted is not None or self._trying is not None:
            return
        if self._process is None:
            self._drop_trial()
            return
        self._trying = self._trial.number
        self._process.send_object(self._trial)
        self._flush()

    def _drop_trial(self) -> None:
        trial, self._trial = self._trial, None
        if trial is not None:
            self._on_trial(TrialResult(number=trial.number, is_dropped=True))

    def _read(self) -> None:
        assert self._process is not None
        arrived = self._process.receive()
        if self._process.has_ended:
            self._end()
            self._after_death()
            return
        for reply in arrived:
            if isinstance(reply, SpliceResult):
                self._splices.discard(reply.number)
                self._on_splice(reply)
                continue
            if isinstance(reply, TrialResult):
                self._trying = None
                if self._trial is not None and self._trial.number == reply.number:
                    self._trial = None
                    self._on_trial(reply)
                continue
            self._be_patient()
            if self._wanted is not None and reply.number == self._wanted.number:
                self._wanted = None
                self._on_reply(reply)
        self._send_trial()

    def _after_death(self) -> None:
        """Try once more what the planner worked on when it ended, then give up."""
        if self._wanted is None:
            return
        self._failures += 1
        if self._failures < FAILURES_MAX:
            self._send()
            return
        request, self._wanted = self._wanted, None
        problem = (str(request.path), None, DIED)
        self._on_reply(
            PlannerReply(
                number=request.number,
                problems=(problem,),
                has_planner=False,
                files=(request.path,),
            )
        )

    def _lose_patience(self) -> None:
        """Start another planner if this one still works on what is not wanted."""
        self._impatience = None
        if self._wanted is not None:
            self._end()
            self._send()

    def _be_patient(self) -> None:
        if self._impatience is not None:
            self._impatience.cancel()
            self._impatience = None

    def _end(self) -> None:
        self._be_patient()
        process, self._process = self._process, None
        self._trying = None
        self._drop_trial()
        self._lose_splices()
        if process is not None:
            asyncio.get_running_loop().remove_reader(process.fileno())
            asyncio.get_running_loop().remove_writer(process.fileno())
            process.close()  # It owns nothing that must be given back, and may stand still.
