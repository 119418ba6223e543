"""klippy.log of Klipper, the firmware of 3D printers: its lines of statistics, one a second."""

from __future__ import annotations

import re

from thermaltool.errors import LogError
from thermaltool.logs.columns import ColumnMap
from thermaltool.logs.frame_table import FrameTable
from thermaltool.logs.table import InputBytes

# "Stats 1234.5: gcodein=0 mcu: mcu_awake=0.001 heater_bed: target=60 temp=59.9 pwm=0.123", of some
# printers behind a stamp, "09-26 07:10:00.000:".
_LINE = re.compile(r"(?:[-\d]+ [:.\d]+:)?Stats (\d+\.\d+): (.*)")
# What the host says of itself stands behind the last section.
_OF_HOST = {
    "sysload", "cputime", "memavail", "print_time", "buffer_time", "print_stall", "gcodein",
    "sd_pos",
}  # fmt: skip


def open_table(source: InputBytes, mapping: ColumnMap) -> FrameTable:
    """The statistics as columns ``section.key``, with the clock ``time_s`` of the host.

    Raises
    ------
    LogError
        No such line.
    """
    import pandas

    rows, lines = [], []
    for number, line in enumerate(source.data.decode(errors="replace").splitlines(), 1):
        found = _LINE.match(line)
        if found is not None:
            rows.append({"time_s": float(found[1]), **_values(found[2])})
            lines.append(number)
    if not rows:
        raise LogError("no klippy.log: no line of Stats", source.name)
    frame = pandas.DataFrame(rows).astype(float)
    return FrameTable(
        frame, mapping.dialect.missing, file=source.name, lines=lines, header_line=lines[0]
    )


def _values(text: str) -> dict[str, float]:
    section, values = "", {}
    for word in text.split():
        key, equals, value = word.partition("=")
        if not equals:
            section = word.removesuffix(":") if word.endswith(":") else section
            continue
        try:
            number = float(value)
        except ValueError:
            continue
        values[f"{section}.{key}" if section and key not in _OF_HOST else key] = number
    return values
