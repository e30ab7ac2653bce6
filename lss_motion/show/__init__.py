"""sequence.yaml ⇄ `Sequence`: keyframes, play lists, layers and events as an author writes them.

===========  =====================================================  ===============================
file         what it is                                             called by
===========  =====================================================  ===============================
`model`      the values: `Sequence`, `Keyframe`, `Layer`, `Cue`, …  every package above
`file`       the keys of a sequence file, their units and bounds    `load`, `show.gait.file`
`load`       file → `Sequence`, with its robot; its JSON Schema     `api`, `cli`
`keyframes`  the keyframes of one track; a sequence at a speed      `load`, `parts`, `trajectory`
`beats`      `at_beat` of a keyframe → the time of that beat         `load`
`functions`  Python functions of a show, looked up and not run      `load`, `playing`, `cli`
`parts`      steps of a play list, layers; a mirrored sequence      `load`
`splines`    slopes and nearest lines of piecewise cubics            `planning`, `interchange`
`check`      what robot and sequence must agree on; what loops      `load`, `interchange`
`key_edit`   keys that are moved, set, added: edits of the text      `studio`
`write`      `Sequence` → file that a person can edit               `cli`
`gait/`      gait.yaml → `Sequence`: robots that walk                `planning`, `cli`, `walking`
===========  =====================================================  ===============================
"""
