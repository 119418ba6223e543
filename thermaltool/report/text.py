"""Plain text: tables, and sentences about a row of a log."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from thermaltool.errors import counted
from thermaltool.model.validity import UnitSuspect, excursions, unit_suspects
from thermaltool.record import map_line
from thermaltool.status import PARTED
from thermaltool.units import Hold, hold_of, parse_channel, printed, symbol

# A sample period that differs from that of the design by less than this is as good [1].
OTHER_PERIOD = 1.5

if TYPE_CHECKING:
    from thermaltool.estimation.batch import EstimatedRecord
    from thermaltool.estimation.changed_machine import Change
    from thermaltool.estimation.estimator import KalmanEstimator
    from thermaltool.estimation.heat_steps import HeatSteps
    from thermaltool.estimation.innovation_test import Alarm
    from thermaltool.estimation.model_departure import ModelDeparture
    from thermaltool.fitting.pauses import PauseSwitch
    from thermaltool.logs import Log
    from thermaltool.model import Excursion, Model, Zero


def aligned(rows: Sequence[Sequence[str]], texts: int | None = None) -> str:
    """Table of columns that are aligned by blanks.

    Parameters
    ----------
    rows : sequence of sequence of str
        The heading first.
    texts : int, optional
        Columns from this one on stand to the right. Default: none.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = len(widths) if texts is None else texts
    sides = [str.ljust] * texts + [str.rjust] * (len(widths) - texts)
    lines = (
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True))
        for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)


def listed(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``.

    Parameters
    ----------
    parts : sequence of str
    """
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if parts[1:] else parts)


def row_message(log: Log, row: int, message: str) -> str:
    """A sentence with the file and the line of a row."""
    return f"{log.name}:{log.lines[row]}: {message}"


def excursion_message(log: Log, e: Excursion) -> str:
    """Where a channel leaves what the calibration has seen."""
    if e.rest is None:
        value, low, high = (f"{each:.4g}" for each in (e.value, e.low, e.high))
    else:
        value, low, high = (f"{each - e.rest:+.3g}" for each in (e.value, e.low, e.high))
        value = f"{e.value:.4g}, {value} from where it begins,"
    return row_message(
        log,
        e.first,
        f"{e.channel}: {value} is outside the calibrated range {low} to {high} "
        f"({counted(e.rows, 'row')}): the model extrapolates",
    )


def range_messages(
    log: Log, model: Model, zeros: Mapping[str, float] | None = None
) -> Iterator[str]:
    """Where a log leaves what the calibration has seen, and where its unit may be another.

    Parameters
    ----------
    log : Log
    model : Model
    zeros : mapping of output to float, optional
        See `excursions`.
    """
    suspects = unit_suspects(model, log.columns)
    for each in suspects:
        yield f"{log.name}: {unit_message(each)}"
    asked = {each.channel for each in suspects}
    for excursion in excursions(model, log.columns, zeros):
        if excursion.channel not in asked:
            yield excursion_message(log, excursion)


def unit_message(suspect: UnitSuspect) -> str:
    """That a channel may be in another unit, and the line of a map that turns it."""
    unit = printed(parse_channel(suspect.channel).unit)
    here, there = (f"{size:.4g} {unit}".rstrip() for size in (suspect.logged, suspect.seen))
    where = "by the model" if suspect.by_model else "in the calibration"
    told = f"{suspect.channel}: its size is {here} here, {there} {where}: is this log in "
    if suspect.unit is None:
        return f"{told}another unit?"
    line = map_line(suspect.channel, suspect.channel, suspect.unit)
    return f"{told}{printed(suspect.unit)}? A {line}"


def spared_map_message(log: Log) -> str:
    """That a column map is not applied to a log that has its names already.

    Parameters
    ----------
    log : Log
    """
    return f"{log.name} has the names that {log.spared_map} gives already: read without it"


def fault_message(log: Log, channels: Container[str] | None = None) -> str | None:
    """How many readings of which channels were left out as faults, and why; None for none.

    Parameters
    ----------
    log : Log
    channels : container of str, optional
        Those that matter. Default: all.
    """
    counts: dict[str, dict[str, int]] = {}
    for fault in log.faults:
        if channels is not None and fault.channel not in channels:
            continue
        why = "spikes" if fault.kind == "spike" else fault.why
        if fault.kind == "fault":
            why = f"at {fault.values[0]:g} degC, {why}"
        reasons = counts.setdefault(fault.channel, {})
        reasons[why] = reasons.get(why, 0) + len(fault.rows)
    if not counts:
        return None
    told = [
        f"{sum(reasons.values())} of {channel} "
        f"({'; '.join(f'{n} {why}' if len(reasons) > 1 else why for why, n in reasons.items())})"
        for channel, reasons in counts.items()
    ]
    return f"{log.name}: faults of sensors left out: {', '.join(told)}; --faults keep takes them"


def stuck_messages(log: Log, channels: Iterable[str]) -> Iterator[str]:
    """Where sensors stand still amid readings that move; from the first row on they may.

    Parameters
    ----------
    log : Log
    channels : iterable of str
    """
    from thermaltool.logs.faults import MEASURED
    from thermaltool.logs.inspect import standstill

    for name in channels:
        if parse_channel(name).quantity in MEASURED and len(log):
            found = [each for each in standstill(log, name) if each.line != log.line(0)]
            more = f", and {len(found) - 1} times more" if found[1:] else ""
            for each in found[:1]:
                yield (f"{log.name}:{each.line}: {name}: {each.message}{more}: a sensor that is "
                       "stuck? These rows count")  # fmt: skip


def still_messages(log: Log, channels: Iterable[str]) -> Iterator[str]:
    """Where sensors stand still all along, in a log that is long enough to tell.

    Parameters
    ----------
    log : Log
    channels : iterable of str
    """
    from thermaltool.logs.faults import MEASURED
    from thermaltool.logs.inspect import MIN_FROZEN_ROWS

    for name in channels if len(log) >= 2 * MIN_FROZEN_ROWS else ():
        column = log.columns[name]
        if parse_channel(name).quantity in MEASURED and column.min() == column.max():
            yield (f"{log.name}: {name}: {column[0]:g} in every row: a sensor that is dead? "
                   "These rows count")  # fmt: skip


def repeated_messages(logs: Sequence[Log]) -> Iterator[str]:
    """Which logs of a fit are there already."""
    for k, log in enumerate(logs):
        if log.digest and any(log.digest == other.digest for other in logs[:k]):
            yield f"{log.name}: the same log again counts twice: the intervals are too narrow"


def jump_messages(log: Log, outputs: Iterable[str], drives: Sequence[str]) -> Iterator[str]:
    """Where an output jumps and no drive does.

    Parameters
    ----------
    log : Log
    outputs : iterable of str
    drives : sequence of str
    """
    from thermaltool.logs.inspect import jump

    for name in outputs:
        if (found := jump(log, name, drives)) is not None:
            yield (f"{log.name}:{found.line}: {name}: {found.message}: a gauge set to zero, "
                   "or another unit? Take the rows on one side (--start, --stop)")  # fmt: skip


def period_messages(log: Log, model: Model) -> Iterator[str]:
    """Where a log has another sample period than its estimator was designed for."""
    if len(log) < 3:
        return
    period, designed = log.period, model.design_period()
    if max(period, designed) > OTHER_PERIOD * min(period, designed):
        yield (f"{log.name}: a row every {period:.3g} s, where the design is for {designed:.3g} s: "
               "it is carried over to this clock, and its errors are others (regularize --dt)"
               )  # fmt: skip


def look_messages(log: Log, found: EstimatedRecord, bands: bool) -> Iterator[str]:
    """What the readings of a log tell of heat, noise, machine and model, beside the estimates."""
    if found.sizes is not None:
        yield sizes_message(found.sizes)
    if found.steps is not None:
        yield steps_message(found.steps)
    elif found.no_steps:
        yield f"the heat is taken to wander; no steps are looked for: {found.no_steps}"
    if found.alarm is not None:
        yield from alarm_messages(log, found.alarm)
    if found.change is not None and found.change.is_clear:
        yield change_message(log, found.change)
    if found.departure is not None:
        yield departure_message(log, found.departure, bands)


def sizes_message(found: KalmanEstimator) -> str:
    """What the readings of a log tell of the heat's changes and of the sensors' noise."""
    walks = [
        f"{name} wanders by {walk:.3g} {symbol(parse_channel(name).unit)}/√s"
        for name, walk in zip(found.drives, found.walk, strict=True)
    ]
    noises = []
    for name, noise in zip(found.sensors, found.noise, strict=True):
        unit = symbol(parse_channel(name).unit)
        drift = f", drift {noise.drift:.3g} {unit} within {noise.drift_time:.3g} s"
        noises.append(f"{name} has noise of {noise.white:.3g} {unit}{drift if noise.drift else ''}")
    return f"as this log tells it, {'; '.join([*walks, *noises])}"


def steps_message(found: HeatSteps) -> str:
    """Which of walk and steps a log makes likelier."""
    by = abs(found.evidence - found.of_walk)
    each = (
        f" (looked for in each of {found.runs} runs between pauses and missing readings)"
        if found.runs > 1
        else ""
    )
    if not found.are_likelier:
        return f"the heat is taken to wander: steps{each} are {by:.3g} nats less likely"
    return (f"the heat is taken to step, {counted(found.count, 'time')}{each}: that is {by:.3g} "
            "nats likelier than a walk alone, which --walk likelihood takes")  # fmt: skip


def alarm_messages(log: Log, alarm: Alarm) -> Iterator[str]:
    """From where on model and machine have parted, or what no test can see of it."""
    if alarm.row is not None:
        yield row_message(log, alarm.row, f"model and machine have parted: {alarm.reason}")
    elif alarm.reason and alarm.word != PARTED:
        # Parted without a row is told as the change that says so.
        yield f"{log.name}: {alarm.reason}"


def change_message(log: Log, found: Change) -> str:
    """By what change of the machine the readings of a log are explained, and what that does."""
    before, after = (f"{each:.4g} s" for each in found.slowest)
    size = f"{abs(100 * found.share):.3g} %"
    what = {
        "loss": f"the machine loses {size} {'more' if found.size > 0 else 'less'} heat than when "
        f"it was calibrated, its slowest time constant is {after}, not {before}",
        "gain": f"{found.sensor} shows {found.size:.4g} times what the model has for it",
        "pace": f"{found.sensor} is {size} {'slower' if found.size > 1 else 'faster'} than the "
        "model has it",
    }[found.kind]
    then = (
        "the estimates are those of such a machine"
        if found.taken
        else "the estimates are those of the model, standard errors hold the difference"
    )
    return f"{log.name}: {what}: {found.likelier:.3g} nats likelier than no change; {then}"


def departure_message(log: Log, found: ModelDeparture, is_held: bool) -> str:
    """How far the readings of a log say that the model is off."""
    gain, pace = (f"{100 * each:.2g} %" for each in found.sizes)
    then = "standard errors hold it" if is_held else "--bands hold it"
    return (f"{log.name}: the readings are {found.evidence:.3g} nats likelier with a model that is "
            f"off, by {gain} of its gains and {pace} of its time constants; {then}"
            )  # fmt: skip


def pause_messages(log: Log, meaning: str) -> Iterator[str]:
    """The pauses of a log (above ``max_gap``), and what they mean here."""
    for part in log.segments[1:]:
        pause = log.time[part.start] - log.time[part.start - 1]
        yield row_message(log, part.start, f"a pause of {pause:g} s; {meaning}")


def pause_switch_message(log: Log, switch: PauseSwitch) -> str:
    """When a command changes during a pause.

    Parameters
    ----------
    log : Log
    switch : PauseSwitch
    """
    since, unit = switch.time - switch.begins, printed(parse_channel(switch.drive).unit)
    what = f"{switch.drive} changes by {switch.step:.4g} {unit} in this pause"
    return row_message(
        log, int(log.time.searchsorted(switch.ends)),
        f"{what}: the outputs tell that it does so {since:.3g} s into it, and it is taken so",
    )  # fmt: skip


def start_message(log: Log, rmse: Mapping[str, float]) -> str:
    """Of a log that does not begin at rest, and by how much outputs are off from rest."""
    off = ", ".join(
        f"{name} {each:.4g} {symbol(parse_channel(name).unit)}" for name, each in rmse.items()
    )
    return (
        f"{log.name}: does not begin at rest: the state of the machine at the first row is "
        f"estimated (--initial rest takes it to be at rest, RMSE then: {off})"
    )


def zero_message(channel: str, zero: Zero, log: Log, computed: str = "simulated") -> str:
    """From what the zero of an output was taken that has none of its own."""
    if zero.rows == 1:
        return f"{channel}: counts from its first reading minus what is {computed} there"
    first = f"the first {zero.stop - log.time[0]:.4g} s ({counted(zero.rows, 'reading')})"
    over = "all rows" if zero.rows > 0.9 * len(log) else first
    return f"{channel}: counts from the median of measured minus {computed} over {over}"


def switched_between_rows(holds: Mapping[str, Hold]) -> list[str]:
    """Sentences on commands that are taken along straight lines.

    Parameters
    ----------
    holds : mapping of channel to "zero" or "first"
        How a model has each drive between the rows.
    """
    return [
        f"{channel}: switches between the rows of these logs: it is taken along straight lines "
        "from row to row, over pauses too"
        for channel, hold in holds.items()
        if (hold, hold_of(channel)) == ("first", "zero")
    ]
