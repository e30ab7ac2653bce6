"""Walks that are steered while they go: who plans ahead, who asks for it, and when.

`planner` turns a wish into the extension of a program, without a clock. `pilot` asks for the next
one in good time and hands it to the player; it waits for nothing. `process` is where the planner
runs while a robot walks: a process of its own, so that planning delays no command.
"""
