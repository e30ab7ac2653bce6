"""Figures of matplotlib without a screen: made for a file, with errors for people.

Used by `trajectory.plot` and `gait.plot`. matplotlib is imported when a figure is made.
"""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.output import write_output

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

DPI: Final = 110
"""Chosen: text is readable at full size on a screen."""


def new_figure(path: Path, width_in: float, height_in: float) -> Figure:
    """Return an empty figure for `path`; raises `InputError` if its suffix cannot be drawn."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    kinds = FigureCanvasAgg(figure).get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in kinds:
        allowed = ", ".join(f".{kind}" for kind in sorted(kinds))
        raise InputError(
            f"cannot draw {path.suffix or 'a file without suffix'}: use {allowed}", path=path
        )
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure; raises `InputError` if the file cannot be written."""
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        # A character that the font does not have is drawn as a box; the warning is no help.
        warnings.simplefilter("ignore")
        figure.savefig(drawn, dpi=DPI, format=path.suffix.lstrip(".").lower())
    write_output(path, drawn.getvalue())
