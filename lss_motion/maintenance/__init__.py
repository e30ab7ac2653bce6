"""Work on servos off the stage: find, configure, watch, calibrate and measure them, record by hand.

Nothing here has a port, a clock or a screen. The modules decide what to query and to command and
interpret the answers; `player.Conversation` or the run loop sends, `lss_motion.playing.connection`
opens the ports, and `cli` interacts with the person.

| file                | what it is                                          | who calls it        |
|---------------------|-----------------------------------------------------|---------------------|
| `discovery.py`      | which servos are on a bus, and their condition      | `cli`, `connection` |
| `findings.py`       | problems and remedies of a scan, first robot file   | `cli.scan`          |
| `settings.py`       | stored values: queries, differences, commands       | `cli.configure`     |
| `backup.py`         | files of stored settings                            | `cli.configure`     |
| `limits.py`         | limits that a robot file leaves to its servos       | `cli`, `connection` |
| `monitor.py`        | polls every servo, raises alarms                    | `cli.monitor`       |
| `hands_on.py`       | joints moved by hand: limp, held, read continuously | `cli`               |
| `take.py`           | recorded motion and poses as a sequence             | `cli.record`        |
| `single_command.py` | what one typed command does, and its limits         | `cli.send`          |
| `calibration.py`    | zero and direction of a joint                       | `cli.hands`         |
| `careful_legs.py`   | small moves that test the units of a servo          | `careful`           |
| `careful.py`        | the first, careful run of one joint                 | `cli.careful`       |
| `identify/`         | measures how a servo responds                       | `cli.identify`      |
"""
