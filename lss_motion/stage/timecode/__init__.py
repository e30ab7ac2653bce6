"""Timecode: a show that follows a lighting desk, or leads one.

Sources are decoded in a process of their own, which sends the player legs: where the leader is, and
at what rate it goes on. `playing.player.following` decides what the robot does about them.

| file       | what it is                                             | who calls it               |
|------------|--------------------------------------------------------|----------------------------|
| `timecode` | labels and seconds, drop-frame; what a person asks for | all below, `load`, `cli`   |
| `ltc`      | linear timecode: bits and sound                        | `receive`, `send`          |
| `messages` | MIDI and Art-Net timecode, and FPP MultiSync, as bytes | `receive`, `send`          |
| `chase`    | from single frames to legs: lock, freewheel, jump      | `receive`                  |
| `midi`     | MIDI ports                                             | `receive`, `send`          |
| `receive`  | the process that reads timecode                        | `source`                   |
| `send`     | the process that sends it                              | `source`                   |
| `source`   | the other end of both, in a run                        | `cli.play`, `stage`        |
"""
