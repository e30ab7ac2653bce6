"""Sequences to trajectories: paths through keyframes, followed as fast as limits and author allow.

`planner.plan` makes a `model.Trajectory`, `verify.verify` is its independent judge, `plot.plot`
draws it. toppra is imported by `parameterize` alone, and only when something must be slowed or
hurried.
"""
