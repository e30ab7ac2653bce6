"""Measures how a servo really responds: small moves, readings, and the model that fits them.

plan         which trials, inside which window
experiment   the trials on a bus: moves on time, questions in between, safe however it ends
asking       the questions of an experiment; `judging` where a horn must not be
recording    what was said and read, and when
motion       where a horn is, under each hypothesis of what the servo does
rests        what the rests alone say: load and play
fit          least squares of that model over all trials, each as a `fit_trial`
estimate     recording → what the servo does, with uncertainties
findings     the same in words, and as fields of the robot file
"""
