"""Files: those of authors, read with their lines, checked, edited in place; and all outputs.

| file | what it is | called by |
|---|---|---|
| `source` | reads bounded text; texts for people: similar names, counts, durations | all readers |
| `record` | what a result was made of, and whether it is unchanged | `source`, `show_cache` |
| `yaml_source` | YAML as plain values with their lines | `validation`, readers of YAML files |
| `validation` | checks values against pydantic models | readers of YAML files |
| `yaml_edit` | changes single values of a YAML text, keeps the rest | `maintenance`, commands |
| `output` | refuses to lose a file, writes one as a whole | all writers |
| `cache` | keeps results; proof of who wrote one | `planning.trajectory.plan_cache`, `show_cache` |
"""
