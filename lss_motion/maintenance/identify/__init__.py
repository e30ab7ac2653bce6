"""Measures how a servo responds: small moves, readings, and the model that fits them.

| file           | what it is                                             | who calls it          |
|----------------|--------------------------------------------------------|-----------------------|
| `trials`       | plan of the trials inside a window, and their readings | `cli`, `joint_run`    |
| `joint_run`    | the trials of one joint; it holds however they end     | `cli`, careful        |
| `response_fit` | response model of a servo, and its least squares       | `estimate`            |
| `estimate`     | recording → servo parameters with uncertainties        | `cli.identify`        |
| `show_pieces`  | the log of a show, cut into pieces, and their model    | `show_fit`            |
| `show_fit`     | these → servo parameters with uncertainties            | `cli.identify`        |
"""
