"""Garbage for a stage, from a computer in it: `python -m rig.storm STAGE FIGURE ADDRESS SEED`.

It sends what a broken or hostile program could: a thousand messages a second with any key and any
content, true messages of others with changed fields among them; and beside them connections whose
bytes are no protocol at all. Ends when its input is closed.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from random import Random

from lss_motion.playing.remote.stage_messages import FireCue
from lss_motion.stage.hosts.messages import Ask, ClockQuestion, FigureStatus, packed
from lss_motion.stage.hosts.peer import NetworkSettings, Peer

KEYS = ("figure/{}/status", "figure/{}/ask", "figure/{}/clock", "beat", "stop", "clock/{}", "x/y")


def main(stage: str, figure: str, address: str, seed: str) -> None:
    """Send until the input is closed."""
    random = Random(seed)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    threading.Thread(target=knock, args=(address, Random(seed + "k"), ended), daemon=True).start()
    names = [figure, "f0", "nobody"]
    settings = NetworkSettings(
        stage=stage, figure=figure, conductor="f0", figures=[figure, "f0"], address=address,
        is_trusted=True,
    )  # fmt: skip
    with Peer(settings) as peer:
        while not ended.is_set():
            for _ in range(10):
                peer.send(random.choice(KEYS).format(random.choice(names)), content(random))
            time.sleep(0.01)


def knock(address: str, random: Random, ended: threading.Event) -> None:
    """Connect, send garbage, and leave or stay, again and again."""
    host, _, port = address.rpartition(":")
    kept: list[socket.socket] = []
    while not ended.is_set():
        with contextlib.suppress(OSError):
            one = socket.create_connection((host, int(port)), 1.0)
            one.sendall(random.randbytes(random.choice((1, 100, 60_000))))
            kept.append(one)
        while len(kept) > 20:
            kept.pop(random.randrange(len(kept))).close()
        time.sleep(0.02)


def content(random: Random) -> bytes:
    """Return garbage, or a message that is well made and not true."""
    kind = random.randrange(5)
    if kind == 0:
        return random.randbytes(random.choice((0, 1, 100, 20_000)))
    if kind == 1:
        return packed(ClockQuestion(asked_ns=random.randrange(-(1 << 61), 1 << 61)))
    if kind == 2:
        return packed(
            Ask(operation=FireCue(label="x"), number=random.randrange(9), instance="0" * 16)
        )
    status = FigureStatus(
        figure=random.choice(("f1", "f9")), instance="0" * 16, version="", state="idle",
        epoch=0, run=0, robot="0" * 64,
    )  # fmt: skip
    text = packed(status)
    return text[: random.randrange(len(text))] if kind == 3 else text + b" " * 9


if __name__ == "__main__":
    main(*sys.argv[1:])
