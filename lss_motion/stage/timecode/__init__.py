"""Timecode: a show that follows a lighting desk, or leads one.

Sources are decoded in a process of their own, which sends the player legs: where the leader is, and
at what rate it goes on. `playing.player.following` decides what the robot does about them.

| file       | what it is                                                |
|------------|-----------------------------------------------------------|
| `timecode` | labels and seconds, drop-frame; what a person asks for    |
| `ltc`      | linear timecode: bits and sound                           |
| `messages` | MIDI and Art-Net timecode, and FPP MultiSync, as bytes    |
| `chase`    | from single frames to legs: lock, freewheel, jump         |
| `midi`     | MIDI ports                                                |
| `receive`  | the process that reads timecode                           |
| `send`     | the process that sends it                                 |
| `source`   | the other end of both, in a run; `cli` and `stage` use it |
"""
