"""One show on many computers.

Each computer (figure) has its own robot, its own player and its own plan; nothing that moves a
servo is sent over the network. One of them, the conductor, plans for all and says when: *legs*,
each an instant of its clock at least a second ahead, a show time and a rate. Every figure knows
that clock to within a bound, and its player follows the legs (`playing.player.following`).

| file             | what it is                                            | used by |
|------------------|-------------------------------------------------------|------------------|
| `clocks`         | the clock of another computer, how well it is known   | `figure`, `host` |
| `messages`       | what conductor and figures send each other            | all below |
| `remote_figures` | what a conductor knows of its figures                 | `conductor`, `figure` |
| `legs`           | where a show is, and how fast it goes on              | `conductor` |
| `conductor`      | one show at a time on all figures: a table of states  | `host`, `conducting` |
| `figure`         | a figure: its table of states                         | `host` |
| `plans`          | plans for all, split, stored and verified by hash     | `host`, `peer` |
| `peer`           | addresses, keys and access; the session with the others | `host` |
| `host`           | one computer: receives, decides, acts                 | `serving` |
| `player_link`    | starts and steers the player of a figure              | `serving` |
| `examine`        | a stage before the doors open: `doctor --stage`       | `host`, `cli` |
| `conducting`     | couples the director of a stage with its conductor    | `serving` |
| `serving`        | one figure of a stage; the conductor's process        | `cli`, `studio`  |

From a cue to a byte: director (`stage.director`) → conductor ↔ figure → player.

`clocks`, `messages`, `conductor`, `figure` and `conducting` have no network, clock or port, and
tests play hundreds of computers in virtual time with them (`tools/benches/stage_model.py`).
"""
