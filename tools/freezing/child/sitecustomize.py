"""Python runs this at the start of a process that the frozen code starts: its bytes are kept."""

import os

if "LSS_FREEZE_WIRE" in os.environ:
    from freezing.inside import record_this_process

    record_this_process()
