"""Files: those of authors, read with their lines, checked, edited in place; and all outputs.

| file | what it is | called by |
|---|---|---|
| `source` | reads bounded text; values that know their line | all readers |
| `texts` | texts for people: tables, counts, similar names; escapes what steers a terminal | all |
| `record` | what a result was made of, and whether it is unchanged | `source`, `show_cache` |
| `yaml_source` | YAML as plain values with their lines | `validation`, readers of YAML files |
| `keys` | classes of keys: what a file may hold, with bounds and descriptions | every `file.py` |
| `validation` | reads what a file holds by its class of keys | readers of YAML files |
| `json_schema` | describes a class of keys for editors | `schema`, `tools/make_reference.py` |
| `yaml_edit` | changes single values of a YAML text, keeps the rest | `maintenance`, commands |
| `output` | refuses to lose a file, writes one as a whole | all writers |
| `cache` | keeps results; proof of who wrote one | `planning.kept` |
"""
