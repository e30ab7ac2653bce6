"""The three bus languages (LSS, LSS-PRO, 2IO) as values and bytes. No port, no clock.

line       one command or reply ⇄ its bytes, and the parsers that no byte can break
table      what a row of a family's table says
lss, lss_pro, io2     the rows, each with its source
codec      physical values ⇄ commands and replies, checked against the rows
constants  status, LED, gyre and baud codes
"""

from lss_motion.protocol.constants import Family
from lss_motion.protocol.line import (
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
