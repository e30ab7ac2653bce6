"""A bus that does not exist: servos, line and faults, as a pure function of time.

bus        `SimBus`: bytes in and out, told the time by its caller
build      from a robot file to its simulated buses
port       `sim://`: a bus as a port of the runner
pty        buses behind pseudo-terminals, in real time
wire, adapter, answering   the two serial lines, byte by byte; USB; who answers when
servo, moves, readings, settings   the firmware of one servo
boards     LSS-2IO boards with their pins
motors, drives, profile, horns, power   how horns move
faults, faults_file   what goes wrong, as rows: written, from a file
hand        a person who leads limp joints
host, drift   a host that oversleeps, and clocks that disagree
physics    every physical number, with its source
truth      what the horns really did

Not modelled: the acceleration sensors of LSS-PRO (they answer 0), the inertia of what hangs on a
horn (a load only pulls by its weight), noise on the lines without a cause in `faults`, the
colours that the LED shows by itself, RC pulses and their 20 ms, EEPROM wear, other sketches of
the LSS-2IO than the 2RC one. An LSS-2IO whose line buffer is overrun loses that section and may
move any of its servos: what a real one does there depends on its build. A servo never says that
its state is unknown (status 0). What no document says is an assumption and marked as one in
`physics` and `boards`.
"""
