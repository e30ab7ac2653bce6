"""The table of each family."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.constants import Family
from lss_motion.protocol.io2 import IO2_TABLE
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.lss_pro import PRO_TABLE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.table import FamilyTable

FAMILY_TABLES: Final[Mapping[Family, FamilyTable]] = {
    Family.LSS: LSS_TABLE,
    Family.LSS_PRO: PRO_TABLE,
    Family.IO2: IO2_TABLE,
}
