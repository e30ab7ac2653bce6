"""Work on servos off the stage: find, configure, watch, calibrate and measure them, record by hand.

Nothing here has a port, a clock or a screen. The modules decide what to query and to command and
interpret the answers; `player.Conversation` or the run loop sends, `lss_motion.playing.connection`
opens the ports, and `cli` interacts with the person.

| file                | what it is                                          | who calls it        |
|---------------------|-----------------------------------------------------|---------------------|
| `api.py`            | scan, identify and calibrate for Python             | `lss_motion`        |
| `survey.py`         | the servos of a bus, their problems and remedies    | `cli.scan`          |
| `settings.py`       | stored values: queries, commands, backups, frames   | `cli.configure`     |
| `monitor.py`        | polls every servo, raises alarms                    | `cli.monitor`       |
| `take.py`           | recorded motion and poses as a sequence             | `cli.by_hand`       |
| `single_command.py` | what one typed command does, and its limits         | `cli.send`          |
| `careful.py`        | the first, careful run of one joint                 | `cli.careful`       |
| `guided.py`         | calibration and identification, led step by step    | `studio`            |
| `identify/`         | measures how a servo responds                       | `cli.identify`      |
| `field/`            | judges what is assumed of servos, in an hour        | `cli.field_test`    |
"""
