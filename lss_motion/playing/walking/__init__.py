"""Robots that are steered while they walk: operator input, planning ahead, and its timing.

============  ==================================================  ==============================
file          what it is                                          called by
============  ==================================================  ==============================
`inputs`      keys and gamepad → commanded velocity of the body   `cli.walk`
`planner`     commanded velocity → extension of the program       `cli.walk`
`pilot`       requests plans in time and gives them to the player `cli.walk`, between two commands
============  ==================================================  ==============================

`planner` and `pilot` read no clock: they get the time as an argument. No call of `pilot` waits.
"""
