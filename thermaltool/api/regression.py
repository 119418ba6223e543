"""Logs in, regressions of thermal errors on temperatures out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, all_of, reads
from thermaltool.api.result import Notice, Result, notice
from thermaltool.api.sensor_placement import is_among, read_logs, read_sensors
from thermaltool.errors import FitError
from thermaltool.units import is_temperature, names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.placement.estimators import Method
    from thermaltool.placement.regression import Basis, RegressionProblem
    from thermaltool.placement.robustness import OutputRegression, Trial

# Powers of the position that are tried where nothing is said.
USUAL_DEGREE = 2


@dataclass(frozen=True, repr=False)
class RegressionReport(Result):
    """Regressions of several outputs.

    Attributes
    ----------
    outputs : tuple of OutputRegression
    logs : tuple of Log
        That were fitted.
    notes : tuple of str
    """

    outputs: tuple[OutputRegression, ...]
    logs: tuple[Log, ...]
    notes: tuple[str, ...] = ()

    @cached_property
    def model(self) -> Model:
        """The model document.

        Raises
        ------
        ModelError
            States whose weight goes with the position.
        """
        from thermaltool.placement.document import regression_document

        provenance = {"logs": [log.source for log in self.logs]}
        pairs = [(each.problem, each.regression) for each in self.outputs]
        return regression_document(pairs, self.logs, provenance)

    def document(self) -> dict[str, Any]:
        """As ``regress --json`` writes it."""
        from thermaltool.report.regression import regression_json

        return {"outputs": regression_json(self.outputs), "notes": list(self.notes)}

    def table(self) -> str:
        """Weights, and errors of every method in every trial."""
        from thermaltool.report.regression import regression_table

        return regression_table(self.outputs)

    def draw(self) -> Figure:
        """Measured and computed outputs over the first log, and their difference."""
        from thermaltool.report.residuals import draw_comparison

        return draw_comparison(self.model, self.logs[0])

    @property
    def frame(self) -> pandas.DataFrame:
        """Errors, one row for each output, method, form and trial."""
        import pandas

        rows = [
            (each.problem.output, *key, trial, error)
            for each in self.outputs
            for key, errors in each.errors.items()
            for trial, error in errors.items()
        ]
        columns = ["output", "method", "form", "trial", "rmse"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:-1])


@reads(Reading)
def regress(
    data: Data | Sequence[Data],
    outputs: str | Sequence[str],
    *,
    sensors: str | Sequence[str] = (),
    position: str | None = None,
    degree: int | None = None,
    time_constants: Sequence[float] | None = None,
    method: Literal["least-squares", "ridge", "elastic-net", "pcr", "pls"] = "ridge",
    condition: str | None = None,
    validate: Data | Sequence[Data] = (),
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> RegressionReport:
    """Thermal errors as sums of temperatures, and how far they hold in other conditions.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
    outputs : str or sequence of str
        Errors, as displacements.
    sensors : str or sequence of str, optional
        Temperatures. Default: all that every log has.
    position : str, optional
        Channel of the position along an axis: weights go with powers of it.
    degree : int, optional
        Highest power, all terms kept. Default: terms up to the second, chosen by the evidence.
    time_constants : sequence of float, optional [s]
        Low-pass states beside each sensor; empty for none. Default: none, one or two, whichever
        predicts best; none along an axis.
    method : {"least-squares", "ridge", "elastic-net", "pcr", "pls"}
        Of the model. The table has all.
    condition : str, optional
        A channel whose values (speeds) are left out one after the other.
    validate : as `data`, optional
        Logs that judge alone.
    start, stop : float, optional [s]
        The stretch of every log.
    warn : callable
        Takes a sentence on what is left out.
    **reading
        See `read_log`.

    Returns
    -------
    RegressionReport

    Raises
    ------
    LogError
        A log that cannot be read, or lacks a channel.
    FitError
        A dead sensor, positions without readings, too few rows.
    ValueError
        Options that contradict each other.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 6000.0, 20.0)
    >>> frame = pd.DataFrame({"time_s": time, "T_a_degC": 20 + np.sin(time / 400)})
    >>> frame["d_z_um"] = 3 * (frame["T_a_degC"] - 20) + 0.01 * np.cos(time)
    >>> found = tt.regress(frame, "d_z_um", time_constants=())
    >>> round(found.model.terms[0].response.dc_gain(), 2)
    3.0
    """
    from thermaltool.placement.regression import moves
    from thermaltool.report.text import stuck_messages

    targets = names(outputs)
    if position is None and degree is not None:
        raise ValueError("a degree needs a position")
    if degree is not None and degree < 0:
        raise ValueError("the degree of a position is 0 or more")
    beside = [name for name in (position, condition) if name is not None]
    span = (start, stop)
    # Along an axis sets of positions follow each other with pauses; without states none matter.
    pauses = position is None
    given = names(sensors)
    logs, every, chosen = read_sensors(
        data, given, targets, beside, (), span, warn, reading, pauses, keep_empty=bool(given)
    )
    if position is not None and is_temperature(position):
        raise ValueError(f"{position} is a temperature: no position along an axis")
    absent = [f"{name} never has a reading: it is left out" for name in every if name not in chosen]
    moving = tuple(name for name in chosen if moves([log.column(name) for log in logs]))
    if moving and not given:
        absent += [f"{n} never moves: it is left out" for n in chosen if n not in moving]
        chosen = moving
    fresh = read_logs(all_of(validate), [*chosen, *beside], targets, span, warn, reading, pauses)
    for log in fresh:
        if is_among(log, logs):
            warn(f"{log.name}: it was fitted: that it is held says nothing of another day")
        for message in stuck_messages(log, (*chosen, *targets)):
            warn(message)
        if still := [name for name in chosen if not moves([log.column(name)])]:
            warn(
                f"{log.name}: {', '.join(still)} never moves: what is missed there may be the "
                "sensor's fault"
            )
    found = []
    for target in targets:
        channels = (*chosen, *([] if position is None else [position]))
        found.append(
            _regressed(logs, fresh, channels, target, len(chosen), position, degree,
                       time_constants, method, condition)
        )  # fmt: skip
    notes = (
        *absent,
        *(
            f"{each.problem.output}: {note}"
            for each in found
            for note in _position_notes(each, degree)
        ),
    )
    return RegressionReport(tuple(found), tuple(logs), notes)


def _regressed(
    logs: Sequence[Log],
    fresh: Sequence[Log],
    channels: Sequence[str],
    target: str,
    count: int,
    position: str | None,
    degree: int | None,
    time_constants: Sequence[float] | None,
    method: Method,
    condition: str | None,
) -> OutputRegression:
    from thermaltool.fitting.data import training_data
    from thermaltool.placement.regression import Basis, RegressionProblem
    from thermaltool.placement.robustness import OutputRegression, trials
    from thermaltool.placement.sensor_choice import best_time_constants

    data = training_data(logs, channels, [target])
    power = 0 if position is None else (USUAL_DEGREE if degree is None else degree)
    sensors = tuple(channels[:count])
    if time_constants is None:
        taus = () if position is not None else best_time_constants(data, sensors)
    else:
        taus = tuple(time_constants)
    basis = Basis(sensors, taus, position, power)
    problem = RegressionProblem(data, basis)
    kept = problem.columns
    if position is not None and degree is None:
        kept = problem.selected()
        problem = problem.with_columns(kept)
    found = problem.fit(problem.every, method)
    at = None if condition is None else problem.joined(condition)
    tried = trials(problem, at, [log.name for log in logs])
    errors: dict[tuple[str, str], dict[str, float]] = {}
    forms: dict[str, Basis] = {"static": replace(basis, time_constants=())}
    if taus:
        forms["lagged"] = basis
    for form, own in forms.items():
        each = RegressionProblem(data, own)
        # The static form has those of the terms that are no states.
        each = each.with_columns([column for column in kept if column in each.columns])
        errors |= _errors(each, form, tried, fresh, channels)
    return OutputRegression(problem, found, errors)


def _errors(
    problem: RegressionProblem,
    form: str,
    tried: Sequence[Trial],
    fresh: Sequence[Log],
    channels: Sequence[str],
) -> dict[tuple[str, str], dict[str, float]]:
    from thermaltool.placement.estimators import METHOD_NAMES
    from thermaltool.placement.robustness import distinct, judged, missed

    inside = judged(problem, METHOD_NAMES, tried)
    found: dict[tuple[str, str], dict[str, float]] = {
        (method, form): dict(own) for method, own in inside.items()
    }
    for log, name in zip(fresh, distinct([log.name for log in fresh]), strict=True):
        for method in METHOD_NAMES:
            try:
                error = missed(problem, log, channels, method)
            except FitError:
                error = float("nan")
            found[method, form][name] = error
    return found


def _position_notes(found: OutputRegression, degree: int | None) -> list[str]:
    problem = found.problem
    if problem.basis.position is None or degree is not None:
        return []
    powers = sorted({c.power for c in problem.columns})
    return [
        f"the evidence keeps {len(problem.columns)} terms with powers "
        f"{', '.join(map(str, powers))} of {problem.basis.position}"
    ]
