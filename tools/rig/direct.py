"""The conductor of a stage with its director: `python -m rig.direct STAGE.yaml FIGURE STORE PORT`.

It is `stage.hosts.stage_job` without the server of its pages. Lines: `c CUE`, `s` stops the show,
`?`.
"""

from __future__ import annotations

import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lss_motion.stage.hosts.conducting import Conducting, Offer
from lss_motion.stage.hosts.plans import planned_stage
from lss_motion.stage.hosts.serving import host_of, states
from lss_motion.stage.load import load_stage

if TYPE_CHECKING:
    from collections.abc import Callable


def main(stage_path: str, figure: str, store: str, port: str) -> None:
    """Conduct until a signal comes."""
    ends: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: ends.append(number))
    stage = load_stage(Path(stage_path))

    def log(text: str) -> None:
        print(f"{time.strftime('%H:%M:%S')} {figure}: {text}", flush=True)

    def write(record: dict[str, Any]) -> None:
        if "text" in record:
            log(record["text"])

    host, robots = host_of(
        stage, figure, port=port, trust_network=True, folder=Path(store), log=log
    )
    made = planned_stage(stage, robots)
    offers = {name: Offer(one.cast, one.contents) for name, one in made.items()}
    run = Conducting(stage, offers, host, write)
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=lambda: [lines.put(line) for line in sys.stdin], daemon=True).start()
    while not ends:
        host.turn()
        while host.cues:
            run.take(*host.cues.popleft())
        while not lines.empty():
            obey(lines.get().split(), run, log)
        run.turn(time.monotonic_ns())
    host.close()


def obey(words: list[str], run: Conducting, log: Callable[[str], None]) -> None:
    """Do what a line says."""
    match words:
        case ["c", cue]:
            run.host.cue(cue)
        case ["s"]:
            run.director.do("stop", time.monotonic_ns())
        case ["?"]:
            for text in states(run.host):
                log(text)


if __name__ == "__main__":
    main(*sys.argv[1:])
