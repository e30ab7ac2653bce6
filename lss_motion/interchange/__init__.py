"""Motions and robots of other tools → our files; samples of a plan → text for other tools.

`import_motion(path, robot)` recognises the format by the content of the file. `exported` writes.

| module        | contents                                                   | callers             |
|---------------|------------------------------------------------------------|---------------------|
| `importing`   | `import_motion` and its steps; the list of readers         | cli, users          |
| `reader`      | `Reader`, and the motion that it returns                   | the readers         |
| `fields`      | checked values from JSON and text, with their place        | the readers         |
| `columns`     | what the names of columns in a table mean                  | `csv`, `poses`, …   |
| `yaml_nodes`  | YAML of other programs as texts with their lines           | `nubots`, `ros`     |
| `labels`      | labels and mouth shapes → keyframes                        | `importing`         |
| `mapping`     | joints of the file → joints of the robot; map files        | `importing`, cli    |
| `voice`       | a sound → the motion of a jaw, a nod, a sway               | cli                 |
| `reduce`      | a recording → few keys within a tolerance                  | `importing`         |
| `fitted_keys` | few shared instants, and angles fitted to the recording    | `reduce`            |
| `recorded`    | the recording of a joint, and the curve between its keys   | the two above       |
| `export`      | samples of a plan → CSV, ROS, Blender                      | cli                 |
| `urdf_robot`  | a URDF or xacro file → a robot file                        | cli                 |
| `urdf_joints` | its joints with a servo, and their limits                  | `urdf_robot`        |
| `urdf_repair` | its masses, inertias and efforts, mended                   | `urdf_robot`        |
| `urdf_legs`   | its legs → a gait file                                     | `urdf_robot`        |

Readers, each a value of `Reader`, called by `importing`:

| module         | formats                                                                |
|----------------|------------------------------------------------------------------------|
| `bvh`          | motion capture as BVH: a skeleton and its frames                       |
| `choregraphe`  | timelines of Choregraphe (NAO, Pepper), and its export to Python        |
| `command_text` | command text of the SSC-32 and of LSS servos; logs and `.lss` programs |
| `csv`          | wide and long CSV tables                                               |
| `d6a`          | action groups of Hiwonder robots (SQLite)                              |
| `json_motions` | JSON of Bit-Bots, HULKs, Reachy Mini, pypot, Blender (add-on), Bottango |
| `label_files`  | labels: Audacity, Rhubarb, Papagayo, Praat, xLights                    |
| `lerobot`      | LeRobot datasets (parquet; needs pyarrow)                              |
| `mcap_files`   | joint states in MCAP files (needs mcap)                                |
| `nubots`       | scripts of the NUbots (YAML)                                           |
| `numpy_files`  | NumPy arrays with names (`.npz`, `.npy`)                               |
| `opencat`      | C arrays of OpenCat skills (Petoi)                                     |
| `poses`        | plain lists of poses in JSON or CSV                                    |
| `robotis`      | Robotis motion files: `.mtn` text and binary pages                     |
| `ros`          | ROS trajectories, `play_motion` collections and goals in YAML          |
| `step_tables`  | steps of Maestro, SSC-32 sequencer, Webots, PyPose                     |
"""
