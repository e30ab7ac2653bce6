"""Computers of a stage that do not exist: network namespaces of this one.

| file       | what it is                                                              |
|------------|-------------------------------------------------------------------------|
| `stage`    | namespaces, lines, hosts and their simulated robots; faults; the judge   |
| `robot`    | one simulated robot behind a pseudo-terminal, in a process of its own    |
| `serve`    | one figure, as `lss-motion serve STAGE --figure NAME` serves it          |
| `proxy`    | a line with delay, jitter, spikes and losses by seed                     |
| `shim/`    | a monotonic clock with offset, drift and a jump, for a process           |

Needs Linux and root.
"""
