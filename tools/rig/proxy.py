"""A line between two computers of the rig: TCP, delayed, with jitter, spikes and losses by seed.

`python proxy.py SEED BASE_MS JITTER_MS SPIKE_RATIO SPIKE_MS LOSS_RATIO LISTEN:PORT=HOST:PORT …`
Each pair is a line. What is lost arrives later, as with TCP. It ends when its input is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from random import Random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from asyncio import Server, StreamReader, StreamWriter
    from collections.abc import Sequence


async def pump(
    reader: StreamReader, writer: StreamWriter, random: Random, model: Sequence[float]
) -> None:
    """Pass on what arrives, in order, each piece so much later."""
    base, jitter, spike_ratio, spike, loss_ratio = model
    loop = asyncio.get_running_loop()
    pieces: asyncio.Queue[tuple[float, bytes] | None] = asyncio.Queue()

    async def deliver() -> None:
        while (piece := await pieces.get()) is not None:
            due, data = piece
            await asyncio.sleep(max(0.0, due - loop.time()))
            writer.write(data)
            await writer.drain()
        writer.close()

    delivering = asyncio.ensure_future(deliver())
    last = 0.0
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            delay = base + random.expovariate(1.0) * jitter
            delay += random.random() * spike if random.random() < spike_ratio else 0.0
            delay += 0.21 if random.random() < loss_ratio else 0.0
            last = max(last, loop.time() + delay)
            pieces.put_nowait((last, data))
    pieces.put_nowait(None)
    with contextlib.suppress(OSError):
        await delivering


async def serve(line: str, seed: str, model: Sequence[float]) -> Server:
    """Listen for one line."""
    listen, _, goal = line.partition("=")
    host, _, port = listen.rpartition(":")
    far_host, _, far_port = goal.rpartition(":")
    count = 0

    async def connected(reader: StreamReader, writer: StreamWriter) -> None:
        nonlocal count
        count += 1
        try:
            far_reader, far_writer = await asyncio.open_connection(far_host, int(far_port))
        except OSError:
            writer.close()
            return
        ways = ((reader, far_writer, "there"), (far_reader, writer, "back"))
        await asyncio.gather(
            *(pump(a, b, Random(f"{seed}/{line}/{count}/{way}"), model) for a, b, way in ways)
        )

    return await asyncio.start_server(connected, host, int(port))


async def main() -> None:
    """Serve all lines until the input is closed."""
    seed, *numbers = sys.argv[1:7]
    model = [float(number) for number in numbers]
    for index in (0, 1, 3):
        model[index] *= 1e-3
    servers = [await serve(line, seed, model) for line in sys.argv[7:]]
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    for server in servers:
        server.close()


if __name__ == "__main__":
    asyncio.run(main())
