"""A bus that does not exist: servos, line and faults, as a pure function of time.

bus        `SimBus`: bytes in and out, told the time by its caller
build      from a robot file to its simulated buses
pty        buses behind pseudo-terminals, in real time
wire       the two serial lines, byte by byte
servo, moves, readings, settings   the firmware of one servo
motors, drives, profile, horns, power   how horns move
faults, faults_file   what goes wrong, as rows
physics    every physical number, with its source
truth      what the horns really did

Not modelled: LSS-2IO boards, the acceleration sensors of LSS-PRO (they answer 0), backlash and
the inertia of what hangs on a horn (a load only pulls by its weight), noise on the lines without
a cause in `faults`, the colours that the LED shows by itself, RC pulses, EEPROM wear. What no
document says is an assumption and marked as one in `physics`.
"""
