"""Steers a running show from outside of the process that plays it.

The player stays alone in its process; whoever steers it is a client at the other end of a
socketpair. Nothing that a client does delays a move: the player reads what has arrived and writes
what the socket takes, and waits for neither. Telemetry that finds a full socket is dropped; events
are kept, up to a bound.

| file         | what it is                                               | who calls it           |
|--------------|----------------------------------------------------------|------------------------|
| `schema`     | operations, events and telemetry: the one schema         | all below, `cli`       |
| `link`       | messages over a stream socket, without waiting           | `player_end`, `handle` |
| `player_end` | the player's end: applies operations, sends what happens | `process`              |
| `job`        | what is played, and how it ended                         | `process`, `handle`    |
| `process`    | the process that plays                                   | `handle`               |
| `handle`     | `start` and `Handle`: the client's end, for Python       | `lss_motion`           |
"""
