"""Trajectory → Program: response model, fit, line schedule, text form (design 7).

response  what a servo does with a move · cone  which speeds keep it near its course
fit, landing, wording  the moves of one joint · line, compile  all joints on their lines
model, text  the program as a value and as a file
"""
