"""Looking after servos: finding them, reading and writing what they store, watching, measuring.

What belongs here decides what to ask and to order, and what the answers mean. It is the core of
the commands of the bench as `player` is that of a show: no port, no clock, no screen. Questions
and orders go through `player.Conversation` or another object that `runtime.runner` can drive;
`lss_motion.connection` opens the ports, `cli` asks people and prints.

pause, listening   let time pass on open ports; say lines and keep all that comes back
roll_call   who is on a bus: rates, ids, ids that several servos share
settings, backup, backup_file   what servos store: differences, orders, dangers; files of it
watch, alarms   all that servos say, as fast as the lines allow; when to call somebody
look, findings, starter   how a servo does; what to tell of it; a robot file to begin with
identify    how a servo really responds: small moves, and the model that fits them
hands_on, polling   joints in a person's hands: limp, held, moved, and read all the time
take, cleaning      what a hand showed, as a sequence
calibration         where a joint's zero is, and which way it turns
"""
