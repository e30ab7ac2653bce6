"""The commands `lss-play` and `lss-motion`: arguments in, text and an exit code out.

A module that `main` imports loads nothing heavy (numpy, yaml, rich) when it is imported: the
help of a command needs none of it. Heavy imports are inside the functions that run a command.
`lss-motion --help` imports no command. A command imports no other command.

Commands, called by `main`:

==============  =================================================================================
agents          `mcp`: shows for a program that writes them
beats           `beats`: tempo and beats of music, as a proposal
by_hand         `record`, `jog`, `calibrate`: with limp joints, or moved by keys
configure       `configure`: compare, write, back up and restore the settings of servos
docs            `docs`: opens the guides
doctor          `doctor`, `devices`: check this computer; its sound devices
examples        `example`: list the packaged examples, write one
exchange        `import`, `export`: motion of other tools, and motion for them
field_test      `field-test`: judge all assumptions about servos in an hour
identify        `identify`: measure the response of servos
import_urdf     `import-urdf`: a robot that others described, as a robot file
manual          `reference`, `completion`: pages of servo commands, scripts for shells
monitor         `monitor`: the live state of all servos
pack            `pack-report`: one file with what is needed to find a fault
planning        `check`, `plan`, `compile`, `schema`, `gait`: all that needs no servo
play            `play`, and the program `lss-play`
publish         `publish`, `verify`: a show as one page that proves itself
report          `report`, `replay`: what a run has left; also called by `play`, `walk`
scan            `scan`: find ports, baud rates and servos
send            `send`: one command to one servo
serving         `studio`, `serve`: a show or a stage in a browser
simulate        `sim`: a simulated robot behind a pseudo-terminal
stages          `stage-keys`, `morning`, `install-service`: what a stage needs around it
walk            `walk`: a gait that is steered while it runs
==============  =================================================================================

Shared by them:

==============  =================================================================================
commands        the list of commands; declares them, loads the robot; all commands
main            `lss-motion COMMAND`: imports the module of that command; `start`, `manual`
options         the options that several commands have, each once; all commands
start           the entry points: signals are handled before anything heavy is imported
messages        prints everything, escaped; turns exceptions into exit codes; all commands
terminal        keys and signals during a run; `play`, `walk`, `identify`, `hands`
careful         the careful run before a show, and what is learnt in it; `play`
dialog          questions before a robot moves or a function runs, and a line an event
display         the live display, a process of its own; `play`, `walk`
linkage         steps of `calibrate --linkage`, with keys
hands           a run with limp joints: keys and screen; `record`, `jog`, `calibrate`
==============  =================================================================================
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""No array here is large enough for a second thread. Starting one costs each command 35 ms of
processor time (measured), and the threads would compete with the player."""
