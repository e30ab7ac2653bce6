"""Judge one recording: tools/run python tools/judge ROBOT.yaml RECORDING.json."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from judge.recording import recording_of
from judge.verdict import objections


def main(arguments: list[str]) -> int:
    """Print the objections; return 1 if there are any."""
    if len(arguments) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    robot = yaml.safe_load(Path(arguments[0]).read_text(encoding="utf-8"))
    record = json.loads(Path(arguments[1]).read_text(encoding="utf-8"))
    found = objections(recording_of(robot, record))
    for one in found:
        print(one)
    print(f"{len(found)} objections")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
