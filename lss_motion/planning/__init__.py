"""From a sequence to a verified program, explained.

| file            | what it is                                          | who calls it             |
|-----------------|-----------------------------------------------------|--------------------------|
| `trajectory/`   | `Sequence` → `Trajectory`: within every limit       | `shows`, `playing.api`   |
| `program/`      | `Trajectory` → `Program`: timed commands, verified  | `shows`, `playing.api`   |
| `shows.py`      | a file to a show: loaded, planned, compiled         | `cli`, `stage`, `studio` |
| `kept.py`       | values on disk, found by what they depend on        | `trajectory`             |
| `show_cache.py` | a show whose files are unchanged, loaded as a whole | `cli`                    |
| `summaries.py`  | the text of plans and programs for people           | `cli`, `studio`          |
| `check_json.py` | what `check --json` prints, as classes              | `cli`, `stage`, `studio` |
| `gait_physics.py` | a walk in the physics of MuJoCo                   | `cli.planning`           |
| `picture.py`    | figures of matplotlib that look alike               | `trajectory.plot`, `cli` |
"""
