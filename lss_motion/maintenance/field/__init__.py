"""The field test: an hour with a real robot that confirms or refutes what is assumed of servos.

| file       | what it is                                                       | who calls it     |
|------------|------------------------------------------------------------------|------------------|
| `runs`     | small moves, and moves through the filter of EM0                 | `measure`        |
| `measure`  | the steps of the hour: what each measures, as figures            | `cli.field_test` |
| `show`     | the reference show at three speeds, what a fit predicts of it    | `cli.field_test` |
| `verdicts` | the assumptions of FACTS.md: confirmed, refuted or not seen      | `archive`        |
| `archive`  | the file of a field test: it is begun, gone on with and compared | `cli.field_test` |
"""
