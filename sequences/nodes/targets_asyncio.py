"""Joints that follow targets from a network: lines of JSON over TCP, in a program with asyncio.

    python sequences/nodes/targets_asyncio.py sequences/robots/desk_arm.yaml
    python sequences/nodes/targets_asyncio.py my_robot.yaml --port /dev/ttyUSB0

Then, in another terminal, a line a target, as often as you like, and each answer is a line with
where the joints are:

    echo '{"elbow": 30, "base": -10}' | nc -q 1 localhost 7600

`set_target` returns at once, so nothing here needs a thread. It listens on this computer only.
"""

from __future__ import annotations

import argparse
import asyncio
import json
from collections.abc import Mapping

import lss_motion as lss

LISTEN = "127.0.0.1"
LINE_MAX_BYTES = 4096


def answer(live: lss.Live, line: bytes) -> dict[str, object]:
    """Obey a line; return where the joints are, or why it was refused."""
    try:
        targets = json.loads(line)
        if not isinstance(targets, Mapping):
            return {"refused": 'a line is an object of joints and degrees: {"elbow": 30}'}
        live.set_target(targets)
    except (ValueError, lss.InputError) as error:
        return {"refused": str(error)}
    return {"deg": live.read()}


async def serve(live: lss.Live, tcp_port: int) -> None:
    """Take lines of any number of clients, until the task is cancelled."""

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(answer(live, line)).encode() + b"\n")
                await writer.drain()
        except (ConnectionError, ValueError):  # It is gone, or its line is too long.
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(talk, LISTEN, tcp_port, limit=LINE_MAX_BYTES)
    async with server:
        print(f"targets on {LISTEN}:{server.sockets[0].getsockname()[1]}; Ctrl-C ends", flush=True)
        await server.serve_forever()


def main() -> None:
    """Connect the robot of the file and serve until Ctrl-C."""
    parser = argparse.ArgumentParser(description="lead joints by lines of JSON over TCP")
    parser.add_argument("robot", metavar="ROBOT", help="a robot file")
    parser.add_argument("--port", help="in place of the port of the file")
    parser.add_argument("--tcp-port", type=int, default=7600, metavar="N")
    arguments = parser.parse_args()
    with lss.connect(lss.load_robot(arguments.robot), port=arguments.port) as live:
        live.set_target({})  # Ready before the first client.
        try:
            asyncio.run(serve(live, arguments.tcp_port))
        except KeyboardInterrupt:
            print("ends")


if __name__ == "__main__":
    main()
