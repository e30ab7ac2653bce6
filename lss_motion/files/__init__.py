"""Files: those of authors, read with their lines, checked, edited in place; and all outputs.

| file | what it is | called by |
|---|---|---|
| `source` | reads bounded text; notes what a result was read from | all readers, `show_cache` |
| `texts` | texts for people: tables, counts, similar names; escapes what steers a terminal | all |
| `yaml_source` | YAML as plain values with their lines | `validation`, readers of YAML files |
| `keys` | classes of keys: what a file may hold, and their JSON Schema | every `file.py` |
| `validation` | reads what a file holds by its class of keys | readers of YAML files |
| `yaml_tree` | where each key, value and item of a YAML text stands | `yaml_edit` |
| `yaml_text` | values as a person writes them in YAML | `yaml_edit`, commands |
| `yaml_edit` | changes what is asked for in a YAML text, keeps the rest | `show`, `robot`, `cli` |
| `output` | refuses to lose a file, writes one as a whole | all writers |
| `cache` | keeps results; proof of who wrote one | `planning.kept` |
"""
