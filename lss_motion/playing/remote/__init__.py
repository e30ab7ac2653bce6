"""Steers a running show from outside of the process that plays it.

The player stays alone in its process; whoever steers it is a client at the other end of a
socketpair. Nothing that a client does delays a move: the player reads what has arrived and writes
what the socket takes, and waits for neither. Telemetry that finds a full socket is dropped; events
are kept, up to a bound.

| file           | what it is                                               | used by |
|----------------|----------------------------------------------------------|--------------------|
| `schema`       | operations and events: the one schema                    | all below, `cli` |
| `edit_messages` | operations on the files of a studio                     | `schema`, `studio` |
| `stage_messages` | operations and events of a stage                       | `schema`, `stage`  |
| `message`      | base of all messages; where every joint is, as bytes     | `schema`, both ends |
| `joint_health` | what servos reported, as that of joints                  | `player_end`       |
| `operator_end` | the client, as a process that moves servos knows it      | `job`, `live_end`  |
| `player_end`   | a show: applies operations, sends what happens           | `job`              |
| `job`          | what is played, and how it ended                         | `handle`, `stage`  |
| `process`      | the process that does a job, and how it is started       | `handle`, `studio` |
| `handle`       | `start` and `Handle`: the client's end, for Python       | `lss_motion` |
"""
