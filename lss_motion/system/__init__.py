"""What the operating system gives: waiting, clocks, signals, ports, processes of this package.

| file           | what it is                                       | who calls it                |
|----------------|--------------------------------------------------|-----------------------------|
| `messages.py`  | a pipe of messages: framing, bounds, decoding    | both ends of a helper       |
| `process.py`   | starts a module in a process; its end            | who needs a helper          |
| `reactor.py`   | the one call that waits; a helper's loop         | clocks, helpers             |
| `clock.py`     | the computer's clock, and virtual time           | `playing`, `sim`            |
| `clock_leg.py` | show time as a function of the run clock         | `playing`, `sound`          |
| `sound_messages.py` | what the process that plays sounds is told  | `playing`, `sound`          |
| `devices.py`   | serial devices, and what may be opened as a port | `port`, `cli`               |
| `port.py`      | serial ports: open, reopen                       | `playing`, `sim`            |
| `real_time.py` | priority, memory and timers of the system        | `playing`, `sim.pty`        |
| `signals.py`   | signals that end a program, at any instant       | `cli`, `playing`, `sim`     |
| `computer.py`  | checks of this computer (`lss-motion doctor`)    | `cli.doctor`                |
| `service.py`   | the unit of systemd, and what it is told         | `cli.stages`, `stage`       |
| `closing.py`   | what is open until `close`, as a context manager | `sound`, `stage`, `playing` |
"""
