"""Side effects of a run: the clock, the ports, the loop that waits, log and report.

| file           | what it is                                      | who calls it               |
|----------------|-------------------------------------------------|----------------------------|
| `runner.py`    | the loop; explains threads, processes and waits | `api`, `connection`, `cli` |
| `clock.py`     | the computer's clock, and virtual time          | `api`, `connection`, `sim` |
| `port.py`      | serial ports: list, open, reopen                | `connection`, `api`, `cli` |
| `real_time.py` | priority, memory and timers of the system       | `runner`, `api`, `sim.pty` |
| `performer.py` | functions and sounds of a show: the pipes       | `api`                      |
| `sounds.py`    | sounds of a show on an open stream: the pipes   | `perform`                  |
| `sound_choice.py` | device and offset; what came of the sounds   | `perform`, `cli`           |
| `performer_process.py` | the process that calls and plays them   | `performer`                |
| `log_mcap.py`  | a log as MCAP, for other programs               | `cli`                      |
| `log.py`       | the log of every byte, written by a process     | `cli`                      |
| `replay.py`    | reads a log, repeats the player's decisions     | `cli.replay`               |
| `report.py`    | the JSON report of a run                        | `api`, `cli`               |
| `signals.py`   | signals that end a program, at any instant      | `cli`, `connection`, `sim` |
| `computer.py`  | checks of this computer (`lss-motion doctor`)   | `cli.doctor`               |
"""
