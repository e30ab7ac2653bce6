"""Triggers from outside: messages of other programs and devices as operations of `remote.schema`.

Each source has a part that knows no clock and no socket (bytes to values), and one that receives in
the one thread of the server. No source reaches the player: the server sends it what counts.

| file      | what it is                                                       | who calls it |
| --------- | ---------------------------------------------------------------- | ------------ |
| `sources` | allow-list, rate limit, thresholds and complaints of all sources | all below    |
| `osc`     | Open Sound Control, with feedback to those who subscribe         | `studio`     |
| `sacn`    | sACN as levels, and the thresholds that they cross               | `studio`     |
| `devices` | MIDI inputs, and buttons at the pins of a Raspberry Pi           | `studio`     |
| `mqtt`    | a broker of messages, Home Assistant, faults to a web hook       | `studio`     |
"""
