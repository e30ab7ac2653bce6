"""Trajectory → Program: response models, fit, line schedule, text form (ARCHITECTURE.md).

response, batch  what servos do with timed moves, one by one and many at once
course, cone  what profiles should do, and which travel speeds keep them near it
lanes, fit, run, next_move, landing, wording, moves  the moves of all timed joints, side by side
drives, step, stream, filtered, predict  the other drives, and all behind one face
attempt, trials, line, columns, compile  all joints on their lines
verify  the last word on the bytes
model, text  the program as a value and as a file
"""
