"""Timecode: a show that follows a lighting desk, or leads one.

Sources are decoded in a process of their own, which sends the player legs: where the leader is, and
at what rate it goes on. `playing.player.following` decides what the robot does about them.

| file        | what it is                                              | used by |
|-------------|---------------------------------------------------------|---------|
| `timecode`  | labels and seconds, drop-frame                          | all below |
| `ltc`       | linear timecode: bits and sound                         | `readers`, `receive` |
| `mtc`       | MIDI timecode: messages                                 | `readers`, `receive` |
| `packets`   | Art-Net timecode and FPP MultiSync: packets             | `readers`, `receive` |
| `chase`     | from single frames to legs: lock, freewheel, jump       | `receive` |
| `readers`   | from bytes and sound to what the chase observes         | `receive` |
| `options`   | what a person asks for, as `lss-play --follow` has it   | `cli`, `stage` |
| `midi`      | MIDI ports                                              | `receive`, `send` |
| `receive`   | the process that reads timecode                         | `source` |
| `send`      | the process that sends it                               | `source` |
| `child`     | a process with a pipe each way                          | `source` |
| `source`    | the other end of both, in a run                         | `cli`, `stage` |
"""
