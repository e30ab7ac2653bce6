"""An independent judge of one run, which finds what no host may do.

It shares no code with the player, the compiler, the simulator or the campaign, and imports none of
them. It is written from the maker's three protocol documents, from the facts about the servos, and
from the robot file as plain YAML. Given the bytes that the host wrote, the bytes that each servo
received, and the angles of the horns, it says where a robot was in danger.

| file | what it holds |
|---|---|
| `recording.py` | the input: joints of a robot file, bytes, restarts, horns |
| `servo.py` | what a servo makes of its bytes: settings in force, moves |
| `rules.py` | the rules about bytes: range, speed, ramps, settings, flood, the last bytes |
| `horns.py` | the rules about horns: range, speed, acceleration |

    tools/run python tools/judge ROBOT.yaml RECORDING.json

Where the documents contradict each other, it takes the reading in which the servo is fastest.
"""
