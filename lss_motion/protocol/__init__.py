"""The three bus languages (LSS, LSS-PRO, LSS-2IO) as values and bytes. No port, no clock.

| module      | contents                                                | callers                 |
|-------------|---------------------------------------------------------|-------------------------|
| `framing`   | commands and replies ⇄ bytes; incremental parsers       | player, sim, cli        |
| `codec`     | physical values ⇄ commands and replies, `FAMILY_TABLES` | player, sim, cli        |
| `table`     | `Row` and `FamilyTable`: the types of the tables        | `codec`, the rows, sim  |
| `lss`       | the rows of the LSS language                            | the other tables        |
| `lss_pro`   | the rows of the LSS-PRO language                        | `codec`                 |
| `io2`       | the rows and limits of the LSS-2IO board                | `codec`, robot, sim     |
| `constants` | `Family`; ids, status, LED and gyre codes, baud rates   | all packages            |
"""

from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import (
    Command,
    CommandParser,
    Garbage,
    Reply,
    ReplyParser,
    encode,
    encode_group,
    encode_move,
)

__all__ = [
    "Command",
    "CommandParser",
    "Family",
    "Garbage",
    "Reply",
    "ReplyParser",
    "encode",
    "encode_group",
    "encode_move",
]
