"""Seeing and running a show in a browser.

| file          | what it is                                              | who calls it      |
|---------------|---------------------------------------------------------|-------------------|
| `view`        | a planned show as JSON, for the timeline of the pages   | the planner       |
| `view_curves` | angles over time as few cubics, in the tolerance of eyes | `view`            |
| `static`      | the pages: plain ES modules, no build step              | the browser       |
"""
