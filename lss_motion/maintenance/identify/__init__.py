"""Measures how a servo responds: small moves, readings, and the model that fits them.

| file           | what it is                                             | who calls it          |
|----------------|--------------------------------------------------------|-----------------------|
| `trials`       | plan of the trials inside a window, and their readings | `cli`, `experiment`   |
| `joint_run`    | moves of one joint on a bus; holds however they end    | `experiment`, careful |
| `experiment`   | the trials of one joint                                | `cli.identify`        |
| `response_fit` | response model of a servo, and its least squares       | `estimate`            |
| `estimate`     | recording → servo parameters with uncertainties        | `cli.identify`        |
| `show_log`     | moves and readings of each servo in the log of a show  | `cli.identify`        |
| `show_pieces`  | a show, cut into pieces of a few moves                 | `show_fit`            |
| `show_model`   | what a servo does in all pieces, by many parameters    | `show_fit`            |
| `show_fit`     | these → servo parameters with uncertainties            | `cli.identify`        |
| `summary`      | the result as text and as fields of the robot file     | `cli.identify`        |
"""
