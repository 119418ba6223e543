"""What is in a log and what is wrong with it, as text."""

from __future__ import annotations

from thermaltool.errors import LogError, counted
from thermaltool.logs import Log
from thermaltool.logs.inspect import Inspection
from thermaltool.record import channel_table
from thermaltool.report.text import spared_map_message

UNKNOWN_UNIT = "unknown unit"


def check_table(log: Log, inspection: Inspection) -> str:
    """Rows, clock and channels of a log, and its findings, one line each."""
    clock = inspection.clock
    since = f", from {log.epoch}" if log.epoch else ""
    lines = [
        f"{log.name}: {counted(inspection.rows, 'row')}, {inspection.duration:g} s{since}, "
        f"{inspection.segments} segment{'' if inspection.segments == 1 else 's'}"
    ]
    if log.spared_map:
        lines.insert(0, spared_map_message(log))
    if inspection.rows > 1:
        lines.append(f"period {clock.period:.6g} s, jitter {clock.jitter:.3g} s")
    if clock.burst_rows:
        lines[-1] += f", in bursts of {clock.burst_rows} rows every {clock.burst_period:g} s"
    lines += channel_table(inspection.channels)
    if not inspection.findings:
        return "\n".join([*lines, "nothing wrong"])
    wrong, units = [], 0
    for each in inspection.findings:
        message = each.message
        if message.startswith(UNKNOWN_UNIT):
            # The units are listed once.
            message, units = message.partition(";")[0] if units else message, units + 1
        wrong.append(str(LogError(message, log.name, each.line, each.column)))
    if units:
        wrong.append("check LOG --write-map MAP.toml drafts a map that gives columns such names")
    return "\n".join([*lines, "wrong:", *wrong])
