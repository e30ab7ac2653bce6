"""The rows of a CSV file of motion: header, separator, the time column, lines for messages."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.interchange.text_lines import TextLines

SECONDS: Final = {
    **dict.fromkeys(["time_s", "t_s", "time", "t", "seconds"], 1.0),
    **dict.fromkeys(["time_ms", "t_ms"], 1e-3),
}
"""Names of a time column, and how many seconds its unit is."""

FRAME: Final = "frame"
FPS_MAX: Final = 1000.0
_FPS: Final = re.compile(r"#\s*fps\s*[:=]\s*(\d{1,4}(?:\.\d{1,6})?)\s*", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True, slots=True)
class CsvRows:
    """The header, and the rows with their lines."""

    lines: TextLines
    header_line: int
    header: list[str]
    delimiter: str
    fps: float | None
    first_row: int

    @property
    def has_commas(self) -> bool:
        return self.delimiter != ","

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line and cells of every row; each has as many cells as the header."""
        text = self.lines.text.split("\n")[self.first_row :]
        reader = csv.reader(text, delimiter=self.delimiter)
        try:
            for row in reader:
                if not row or (len(row) == 1 and not row[0].strip()) or row[0].startswith("#"):
                    continue
                number = self.first_row + reader.line_num
                if len(row) != len(self.header):
                    self.lines.refuse(
                        number,
                        f"{len(row)} cells, but the header has {len(self.header)}: is the file "
                        "cut short?",
                    )
                yield number, row
        except csv.Error as error:
            raise InputError(
                f"no table: {error}", path=self.lines.path, line=self.first_row + reader.line_num
            ) from error

    def time_column(self) -> tuple[int, float]:
        """Return where the time stands, and how many seconds its unit is."""
        names = [name.lower() for name in self.header]
        at = next((at for at, n in enumerate(names) if n in SECONDS or n == FRAME), None)
        if at is None:
            self.lines.refuse(
                self.header_line,
                f"no column is the time; name it {', '.join(SECONDS)} or {FRAME}, in a header line",
            )
        if names[at] != FRAME:
            return at, SECONDS[names[at]]
        if self.fps is None:
            self.lines.refuse(
                self.header_line, "frames need their rate: put a line `# fps: 24` on top"
            )
        return at, 1.0 / self.fps


def csv_rows(lines: TextLines) -> CsvRows:
    """Return the table below its comments, one of which may give the rate of frames."""
    fps: float | None = None
    found: tuple[int, str] | None = None
    for number, line in lines.numbered():
        if match := _FPS.fullmatch(line):
            fps = float(match[1])
            if not 0.0 < fps <= FPS_MAX:
                lines.refuse(number, f"fps {fps:g} must be more than 0 and at most {FPS_MAX:g}")
        if not line.startswith("#"):
            found = number, line
            break
    if found is None:
        lines.refuse(None, "has no header line")
    number, line = found
    delimiter = max(",;\t", key=line.count)
    try:
        header = [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error as error:
        raise InputError(f"no table: {error}", path=lines.path, line=number) from error
    if twice := [name for name in header if header.count(name) > 1]:
        lines.refuse(number, f"column {twice[0]!r:.60} stands there twice")
    return CsvRows(lines, number, header, delimiter, fps, number)
