"""Sequences to trajectories: paths through keyframes, followed as fast as limits and author allow.

`planner.plan` is the entry point. It returns a `model.Trajectory` that has passed `verify.verify`.

| file            | what it is                                           | called by               |
|-----------------|------------------------------------------------------|-------------------------|
| `planner.py`    | `plan`: sequence and robot to trajectory             | api, cli                |
| `model.py`      | `Trajectory`, its passes, the clock of a path        | program, player, cli    |
| `tracks.py`     | keyframes of a track, tracks in parallel             | planner                 |
| `window.py`     | motion between two boundary states, around an edit   | walking, studio         |
| `playlist.py`   | steps one after the other; cues in every pass        | planner, layers         |
| `layers.py`     | layers blended on top of a show                      | planner                 |
| `keys.py`       | the keys of each joint, checked, with path positions | retime, curves, tracks  |
| `curves.py`     | the cubics between keys, for each ease; `Path`       | all that plan           |
| `commands.py`   | the ease `command`: what servos do by themselves     | curves                  |
| `retime.py`     | paths of a sequence, and the clock that follows them | tracks, layers, planner |
| `servo_rows.py` | servos behind mechanisms along a path                | retime, solver          |
| `servo_motion.py` | the motion of joints as that of their servos       | program, playing        |
| `dues.py`       | what the author wants, and how late a motion is      | catch_up, explain       |
| `free_spans.py` | where the motion may leave the author's curve        | catch_up                |
| `ahead.py`      | ahead of that curve, on time at the keys             | catch_up                |
| `catch_up.py`   | faster while late, back at the author's pace in time | retime                  |
| `keep_time.py`  | joints that keep their time, beside others           | planner                 |
| `keep_joint.py` | one of them: windows, exact keys, what is given up   | keep_time               |
| `closest_spline.py` | the closest motion within limits; Clarabel    | keep_joint              |
| `braking.py`    | back at the author's pace exactly where on time      | catch_up                |
| `solver.py`     | largest legal rates along a path; imports toppra     | retime, tracks          |
| `smoothing.py`  | no jumps of the acceleration, where that is wanted   | planner, layers         |
| `verify.py`     | independent check against all limits                 | tracks, layers, planner |
| `kept_plans.py` | plans on disk, verified again when they are loaded   | planner, layers         |
| `explain.py`    | slowed spans, marks, anchors that are met or missed  | tracks, layers          |
| `more_time.py`  | how much more time anchors need that are missed      | planner                 |
| `eases.py`      | where `spline` or `smooth` makes a motion later      | summaries               |
| `torques.py`    | torque, current and heat of servos that carry masses | summaries, plot         |
| `touches.py`    | links of a figure that touch each other              | summaries, check_json   |
| `plot.py`       | a picture of a trajectory                            | cli                     |

toppra takes a second to import. It is imported only where a motion must be slowed or made as fast
as possible; a plan from the cache loads neither toppra nor the modules that make plans.
"""
