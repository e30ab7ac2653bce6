"""Other tools' motion files ⇄ Sequence, Trajectory.

`import_motion(path, robot)` recognises the format by content. Its steps, each usable alone: read
what the file says (`read_motion`, `read_motions`), say it in joints of a robot (`mapped`, with the
map that `load_map` reads and `map_template` begins), reduce a recording to keys (`reduced`), and
make a sequence of it (`sequence_for`). `exported` turns samples of a plan into other tools' text.
"""

from lss_motion.interchange.export import EXPORT_NAMES, Samples, exported
from lss_motion.interchange.importing import (
    FORMAT_NAMES,
    READERS,
    Imported,
    import_motion,
    imported,
    read_motion,
    read_motions,
    sequence_for,
)
from lss_motion.interchange.mapping import MotionMap, load_map, map_template, mapped
from lss_motion.interchange.reader import (
    Channel,
    ForeignMotion,
    Reader,
    RefusedMotion,
    Unit,
)
from lss_motion.interchange.reduce import KeyFit, reduced

__all__ = [
    "EXPORT_NAMES",
    "FORMAT_NAMES",
    "READERS",
    "Channel",
    "ForeignMotion",
    "Imported",
    "KeyFit",
    "MotionMap",
    "Reader",
    "RefusedMotion",
    "Samples",
    "Unit",
    "exported",
    "import_motion",
    "imported",
    "load_map",
    "map_template",
    "mapped",
    "read_motion",
    "read_motions",
    "reduced",
    "sequence_for",
]
