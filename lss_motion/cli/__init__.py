"""`lss-play` and `lss-motion`: arguments in, text and exit codes out; nothing heavy at import."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""No array here is so large that a second thread would help; starting one costs each command 35 ms
of processor time (measured), and they would stand beside the player."""
