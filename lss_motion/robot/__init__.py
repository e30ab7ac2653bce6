"""robot.yaml ⇄ `Robot`: buses, joints, limits and poses; what each servo model can do.

==============  ================================================  ==================================
file            what it is                                        called by
==============  ================================================  ==================================
`model`         the values: `Robot`, `Joint`, `Bus`, `Response`   every package above
`servo_models`  the servo models and families, drives that fit    `load`, `program`, `player`
`profile`       how a servo moves on one command, its ramps        `trajectory`, `program`, `player`
`on_fault`      faults of joints, and the steps taken on them     `model`, `program`, `player`
`mechanism`     what stands between joints and servos, by name     `model`, `planning`, `playing`
`transmission`  its kinds: matrix, curve of a linkage, surface     `mechanisms`
`mechanisms`    transmissions of a robot file, limits behind them  `servos`, `planning`
`servos`        joints behind transmissions, and their servos      `load`
`figure`        links that turn with joints, their masses          `figure_links`, `urdf`, `gait`
`dynamics`      the torques that a motion asks of a figure          `planning`
`urdf`          a URDF file → `Figure`                            `gait`
`figure_links`  the figure of a robot file                         `load`
`file`          the keys of a robot file, their units and bounds  `load`, `show.file`
`figure_file`   those of `figure` and `urdf`                      `file`, `figure_links`
`linkage_file`  those of a linkage; angles and lengths             `file`, `mechanisms`, `show`
`load`          file → `Robot`; its JSON Schema                   `api`, `cli`, `show`, `stage`
`write`         measured values → a robot file that exists        `cli`
`learnt`        what was learnt about a robot, beside its file    `cli.careful`
==============  ================================================  ==================================
"""
