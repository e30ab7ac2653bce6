"""One figure of a stage: `python -m rig.serve STAGE.yaml FIGURE STORE PORT [--real-time]`."""

from __future__ import annotations

import sys
from pathlib import Path

from lss_motion.cli.messages import put
from lss_motion.stage.hosts.serving import serve_figure
from lss_motion.stage.load import load_stage

if __name__ == "__main__":
    stage, figure, store, port, *rest = sys.argv[1:]
    sys.exit(
        serve_figure(
            load_stage(Path(stage)),
            figure,
            port=port,
            trust_network=True,
            folder=Path(store),
            is_real_time="--real-time" in rest,
            print_line=put,
        )
    )
