"""Seeing, editing and running a show in a browser.

The server shows and edits a file, plans it again when it changes, and starts and steers the process
that plays it. Four processes: server, planner, player, and one that only stops; none waits for
another, so a server or planner that hangs, stands still or is killed blocks no stop.

| file          | what it is                                                 | who calls it       |
| ------------- | ---------------------------------------------------------- | ------------------ |
| `server`      | opens the sockets, serves until a signal ends it           | `cli`              |
| `studio`      | one running studio: what it is made of                     | `server`, `app`    |
| `app`         | routes and their guard                                     | `server`           |
| `access`      | who may what, as a pure decision; pairing codes            | `app`, `stop`      |
| `hub`         | the clients, which one operates, the order of operations   | `app`, `desk`      |
| `client`      | what waits for one client, and how much it may send        | `hub`, `app`       |
| `desk`        | carries operations out                                     | `studio`, `hub`    |
| `document`    | the open file: edits, revision, errors, last good plan     | `desk`, `studio`   |
| `operations`  | operations on files → their new texts, pure                | `document`         |
| `allowed`     | what no edit may make of a file                            | `document`         |
| `history`     | undo and redo across files                                 | `document`         |
| `drafts`      | edited texts and the disk: saved, recovered, compared      | `document`         |
| `folder`      | what lies in the folder of a show, by kind                 | `app`              |
| `uploads`     | routes that bring sounds into a show                       | `app`              |
| `listening`   | the process that finds beats and keys in sounds            | `uploads`          |
| `trial`       | what an edit would do: the plan of a window around it      | `planner`          |
| `planning`    | the server's end of the planner: the latest request wins   | `studio`           |
| `planner`     | the process that plans: file → plan, view, job             | `planning`         |
| `robot_view`  | a robot as JSON, for the pages                             | `planner`          |
| `view`        | a planned show as JSON, for the timeline of the pages      | `planner`          |
| `view_curves` | angles over time as few cubics, within what an eye sees    | `view`             |
| `view_horns`  | where the bytes take the joints, as such cubics             | `view`             |
| `playing`     | the server's end of the process that plays                 | `desk`             |
| `latch`       | the stop that is kept: `stop` writes it, the server reads  | `stopping`, `stop` |
| `stopping`    | the server's end of the process that only stops            | `studio`           |
| `stop`        | the process that only stops                                | `stopping`         |
| `stage_service` | what the server of a stage does besides                  | `cli.serving`      |
| `api`         | the HTTP interface of a stage                              | `stage_service`    |
| `inlets`      | the sources of triggers of a stage, opened and kept open   | `stage_service`    |
| `keeper`      | keeps the player of a stage running                        | `stage_service`    |
| `metrics`     | what Prometheus is told of a stage                         | `stage_service`    |
| `web`         | listening sockets, and uvicorn as both servers use it      | `server`, `stop`   |
| `publish`     | a show as one page, and whether such a page is consistent  | `cli.publish`      |
| `entrance`    | who may be connected: few strangers, shares of roles       | `web`              |
| `static`      | the pages: plain ES modules, no build step                 | the browser        |
"""
