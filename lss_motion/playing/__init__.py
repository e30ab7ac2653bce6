"""What plays: the player, the loop that drives it, its process, its log and report.

| file                | what it is                                     | who calls it             |
|---------------------|------------------------------------------------|--------------------------|
| `player/`           | the state machine; no clock, port, thread      | everything here          |
| `remote/`           | the process that plays; its messages           | `stage`, `studio`, `api` |
| `walking/`          | a gait that is steered while playing           | `cli.walk`, `remote`     |
| `api.py`            | `lss.load_robot`, `lss.play`, …                | users                    |
| `run.py`            | one run, of a show or of many, on open ports   | `api`, `cli`, `stage`    |
| `targets.py`        | joints follow targets: the one limiter         | `remote`, `live`         |
| `live.py`           | `lss.connect`: a robot without a show          | users, `live_end`        |
| `live_end.py`       | the same for a client: jog, poses, limp, hold  | `studio`                 |
| `connection.py`     | the open ports of a robot                      | `run`, `live`, `cli`     |
| `discovery.py`      | servos on a bus, their condition, their limits | `connection`, `cli`      |
| `hands_on.py`       | joints moved by hand: limp, held, read         | `live`, `cli`            |
| `hands_poller.py`   | what asks those servos and sends to them       | `hands_on`               |
| `hands_mapping.py`  | their readings and targets as those of joints  | `hands_on`               |
| `joint_view.py`     | angles and faults of servos as those of joints | `remote`, `live`         |
| `runner.py`         | the loop; threads, processes and waits         | `run`, `connection`      |
| `performer.py`      | functions and sounds of a show: the pipes      | `run`                    |
| `performer_process` | the process that calls and plays them          | `performer`              |
| `show_modules.py`   | their modules, from the bytes agreed to        | `performer_process`      |
| `sounds.py`         | sounds of a show on an open stream             | `run`                    |
| `sound_choice.py`   | device and offset; what came of the sounds     | `run`, `cli`             |
| `log.py`            | the log of every byte, written and read        | `runner`, `replay`       |
| `log_mcap.py`       | a log as MCAP                                  | `cli.exchange`           |
| `replay.py`         | repeats the player's decisions from a log      | `cli.report`             |
| `report.py`         | the JSON report of a run, or of many shows     | `run`, `cli`             |
| `report_joints.py`  | the report of servos as that of their joints   | `run`                    |
| `truth.py`          | what simulated horns did                       | `run`                    |
| `robustness.py`     | shows played with deviations                   | `cli.planning`           |
"""
