"""One show on many computers.

Each computer (figure) has its own robot, its own player and its own plan; nothing that moves a
servo is sent over the network. One of them, the conductor, plans for all and says when: *legs*,
each an instant of its clock at least a second ahead, a show time and a rate. Every figure knows
that clock to within a bound, and its player follows the legs (`playing.player.following`).

| file        | what it is                                                  | used by |
|-------------|-------------------------------------------------------------|--------------------|
| `clocks`    | the clock of another computer, and how well it is known     | `figure`, `host`   |
| `messages`  | what conductor and figures send each other                  | all below          |
| `conductor` | state of the conductor: readiness, legs, lost figures       | `figure`, `host`   |
| `figure`    | state of a figure: ready, in step, alone, stopped           | `host`             |
| `plans`     | plans for all, split, stored and verified by hash           | `host`, `peer`     |
| `settings`  | addresses, keys and access; the configuration of zenoh      | `peer`             |
| `keys`      | a small authority and a certificate for each figure         | `cli`              |
| `peer`      | the session with the others: the only importer of zenoh     | `host`             |
| `host`      | one computer: takes, decides, acts                          | `serving`          |
| `player_link` | starts and steers the player of a figure                  | `serving`          |
| `examine`   | a whole stage before the doors open: `doctor --stage`       | `host`, `cli`      |
| `serving`   | one figure of a stage, until it is ended                    | `cli`              |
| `conducting` | the director of a stage, and the conductor of its figures | `stage_job`        |
| `stage_job` | the conductor's process, steered by the server of its pages | `studio`           |

`clocks`, `messages`, `conductor`, `figure` and `conducting` have no network, clock or port, and
tests play hundreds of computers in virtual time with them (`tools/benches/stage_model.py`).
"""
