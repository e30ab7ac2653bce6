"""Robots that are steered while they walk: operator input, planning ahead, and its timing.

============  ==================================================  ==============================
file          what it is                                          called by
============  ==================================================  ==============================
`inputs`      keys and gamepad → commanded velocity of the body   `cli.walk`
`steered`     limits, planner and pilot for given velocities      `cli.walk`, `remote`
`planner`     commanded velocity → extension of the program       `cli.walk`, `steered`
`pilot`       requests plans in time and gives them to the player `cli.walk`, `steered`
============  ==================================================  ==============================

`planner` and `pilot` read no clock: they get the time as an argument. No call of `pilot` waits.
"""
