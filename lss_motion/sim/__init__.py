"""A simulated robot: servos, boards, serial lines and faults, as a pure function of time.

| file | what it is | called by |
|---|---|---|
| `bus` | `SimBus`: bytes in, bytes out, at given instants; `sim://` | `connection`, `pty` |
| `pty` | buses behind pseudo-terminals, in real time | `lss-motion sim`, tests, benches |
| `wire` | the two serial lines byte by byte, the USB adapter, the order of replies | `bus` |
| `servo` | the firmware of one servo: commands, moves, RC mode, LED | `bus` |
| `odd_lines` | lines that no document describes: counted, and how they are read | `bus` |
| `readings` | the settings of a servo and its answers | `servo` |
| `boards` | LSS-2IO boards with their pins | `bus` |
| `motors` | all motors of a bus: orders, current, temperature, safe mode | `bus`, `servo` |
| `horns` | how horns follow their profiles, with load and play | `motors` |
| `profile` | the trajectory that a servo generates for one move | `horns`, `servo` |
| `physics` | every physical number, with its source | all |
| `faults` | faults as rows, from code or from a file | `bus`, `wire`, `lss-play` |
| `deviation` | how the robot differs from what is assumed (`--sim`) | `connection`, `perform` |
| `hand` | a person who moves limp joints by hand | `motors`, `lss-motion sim` |

Not modelled: the acceleration sensors of LSS-PRO (they answer 0), the inertia of a load (it only
pulls by its weight), noise on the lines other than that of `faults`, the colours that the LED
shows at start, the 20 ms between RC pulses, EEPROM wear, sketches of the LSS-2IO other than 2RC.
An LSS-2IO whose line buffer is overrun loses that section and may move any of its servos: what a
real one does then depends on its build. A servo never reports an unknown state (status 0). A
number without a published source is marked as assumed in `physics` and `boards`.
"""
