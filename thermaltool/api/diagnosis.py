"""What a model gets wrong on measured logs, and why."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import (
    Reading,
    all_of,
    as_model,
    drives_over_pauses,
    read,
    reads,
    warn_pauses,
    write_model,
)
from thermaltool.api.pauses import switches_in, with_switches
from thermaltool.api.result import Notice, Result, notice, silent
from thermaltool.documents import source_name, write_whole
from thermaltool.errors import LogError, ModelError, counted
from thermaltool.record import hint, in_another_unit

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.inputs import ModelLike
    from thermaltool.diagnosis.result import Diagnosis
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model

    Tolerance = str | float | Sequence[str] | Mapping[str, str | float]


@dataclass(frozen=True, repr=False)
class DiagnosisReport(Result):
    """A diagnosis, and the logs that it is of.

    Attributes
    ----------
    diagnosis : Diagnosis
        Causes, what they are worth, what is left open.
    model_name : str
        What the report calls the model.
    logs, unseen, calibration : tuple of Log
        Diagnosed, validated on, and the calibration's own where they were found.
    tolerance : mapping of output to float [unit of the output]
        Against which severity is told.
    """

    diagnosis: Diagnosis
    model_name: str
    logs: tuple[Log, ...]
    unseen: tuple[Log, ...]
    calibration: tuple[Log, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)

    @property
    def adequate(self) -> bool:
        """Whether noise and the calibration's own error account for what is left."""
        return self.diagnosis.adequate

    @property
    def model(self) -> Model:
        """The model extended by the causes."""
        return self.extended()

    def extended(self, command: str | None = None) -> Model:
        """The model extended by the causes; it tells where they come from, and its errors there.

        Parameters
        ----------
        command : str, optional
            How it was made.

        Raises
        ------
        ModelError
            A log would be worse by it.
        """
        from thermaltool.diagnosis.written import with_agreements

        model = self.diagnosis.model
        if self.diagnosis.spoiled is not None:
            raise ModelError(f"{self.diagnosis.spoiled} would be worse by the extended model")
        if not self.diagnosis.extends:
            return model
        made: dict[str, Any] = {"logs": [log.source for log in self.logs]}
        if command is not None:
            made["command"] = command
        model = with_agreements(model, self.logs)
        return replace(model, provenance={**model.provenance, "diagnosed": made})

    def write_extended(self, target: str, came_from: str, command: str | None = None) -> None:
        """Write the extended model; the one that came in byte for byte where nothing changes.

        Parameters
        ----------
        target, came_from : str
            Files; the model that came in may be no file.
        command : str, optional
            How it was made.

        Raises
        ------
        ModelError
            A log would be worse by it.
        """
        if self.diagnosis.extends or not os.path.isfile(came_from):
            write_model(self.extended(command), target)
        else:
            with open(came_from, "rb") as same:
                write_whole(same.read(), target)

    @property
    def frame(self) -> pandas.DataFrame:
        """Parameters of the causes with their 95 % intervals, one row each; NaN where given."""
        import pandas

        rows = []
        for cause in self.diagnosis.causes:
            effect = cause.effect
            for name, value in effect.parameters.items():
                low, high = cause.intervals.get(name, (float("nan"), float("nan")))
                place = effect.name, effect.channel, name
                rows.append((*place, value, low, high, effect.unit(name), cause.evidence))
        columns = ["cause", "channel", "parameter", "value", "low", "high", "unit", "evidence"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:3])

    def exceeds(self, share: float) -> bool:
        """Whether more than this share of an output's residual power is above noise."""
        return 1 - self.diagnosis.noise_share > share

    def document(self) -> dict[str, Any]:
        """The diagnosis as JSON-ready data, with the model and the logs that it is of."""
        sound = self.diagnosis.sound
        return {
            **self.diagnosis.document(self.tolerance),
            "model": self.model_name,
            "logs": [{**log.source, "begins_s": float(log.time[0])} for log in self.logs],
            "validated_on": [log.source for log in self.unseen if log.digest not in sound],
            "sound": [log.source for log in self.unseen if log.digest in sound],
            "calibrated_on": [log.source for log in self.calibration],
        }

    def table(self) -> str:
        """The verdict, the causes and what is not known, in sentences and tables."""
        from thermaltool.report.diagnosis import short_form

        return short_form(self.document())

    def draw(self) -> Figure:
        """The output that is wrong most: measured, by the model, by the extended model."""
        from thermaltool.report.diagnosis_figures import draw_curves, worst

        return draw_curves(*worst(self.diagnosis.curves), self.document())

    def write(self, path: str, check: Callable[[str], None] = silent) -> None:
        """Write the whole report in Markdown, with its figures beside it as PNG.

        Parameters
        ----------
        path : str
        check : callable
            Takes the file of each figure before it is written, and may refuse it.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        from thermaltool.report.diagnosis_markdown import write_report

        write_report(path, self.document(), self.diagnosis.curves, check)


@reads(Reading)
def diagnose(
    model: ModelLike,
    data: Data | Sequence[Data],
    *,
    validate: Sequence[Data] = (),
    tolerance: Tolerance = (),
    limits: str = "",
    warn: Notice = notice,
    progress: Notice = silent,
    **reading: Unpack[Reading],
) -> DiagnosisReport:
    """Name what a model gets wrong on measured logs, why, and what knowing it is worth.

    Compares the residual with the noise of the same log, tries every cause of the catalogue,
    extends the model by those that have evidence and help on data that the fit has not seen, and
    says what these logs cannot tell apart.

    Parameters
    ----------
    model : Model, a result that holds one, str or path
    data : str, path, pandas.DataFrame, Record, or a sequence of them
    validate : sequence of str, path, pandas.DataFrame or Record
        Logs that no fit sees, on which gains are measured. Without them those of the written
        model are told on `data`, beside those on stretches of it that were held out in turn.
    tolerance : str, float, sequence of str, or mapping of output to str or float
        What an output may be off by: ``"5um"``, ``5`` in its own unit, ``"d_z_um=5um"``. The
        severity of each cause is told against it.
    limits : str
        What can be done at the machine, ``"switch=30s,run=4h,fixed=Q_fan_1,set=T_bed_degC"``:
        shortest time between switches, longest run (a working day or the longest log without
        one), channels that cannot be set, and temperatures or displacements that can, which are
        else taken for what a sensor reads. Experiments that are asked for keep within.
    warn, progress : callable
        Take a sentence where the model extrapolates or a log pauses, and a word now and then.
    **reading
        See `read_log`.

    Returns
    -------
    DiagnosisReport

    Raises
    ------
    LogError
        A log that cannot be read, lacks a drive or has no output of the model, is in
        another unit by its size or by what the model makes of it; the same log twice.
    ModelError, FitError
        Nothing to judge the model by.
    UnitError
        A tolerance that fits no output, a limit of another form.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time, noise = np.arange(0.0, 1200.0, 10.0), np.random.default_rng(1)
    >>> def frame(jump):
    ...     heat = np.where(time < 60, 0.0, 100.0)
    ...     read = 20 * -np.expm1(-np.maximum(time - 60, 0) / 200) + jump * (time > 800)
    ...     read = read + 0.05 * noise.standard_normal(len(time))
    ...     return pd.DataFrame({"time_s": time, "Q_motor_W": heat, "d_z_um": read})
    >>> fit = tt.calibrate(frame(0.0), ["Q_motor_W"], deflections=["d_z_um"])
    >>> tt.diagnose(fit, frame(0.0)).adequate
    True
    >>> [cause.effect.name for cause in tt.diagnose(fit, frame(-1.0)).diagnosis.causes]
    ['geometry_step']
    """
    from thermaltool.diagnosis.course_units import course_suspects
    from thermaltool.diagnosis.diagnose import MIN_ROWS
    from thermaltool.diagnosis.diagnose import diagnose as run
    from thermaltool.diagnosis.limits import limits_of
    from thermaltool.diagnosis.severity import tolerances_of
    from thermaltool.model.validity import ABSOLUTE_UNITS, unit_suspects
    from thermaltool.report.text import range_messages, unit_message

    found = as_model(model)
    drives, outputs = ([each.channel for each in group] for group in (found.drives, found.outputs))
    allowed = tolerances_of(_typed(tolerance), outputs)

    # Told once all logs are found fit to judge by: an error is one line.
    remarks: list[str] = []
    unread: list[str] = []

    def judged(each: Data) -> Log:
        # Those of an output are found beside the model, left out and named: the cause `outliers`.
        log = read(each, found.needs(), keep_spikes=outputs, warn=remarks.append, **reading)
        log, dead = _judged_by(log, found)
        unread.extend(f"{log.name}: {o}: {why}: it is not judged there" for o, why in dead.items())
        if len(log) < MIN_ROWS:
            few = f"{counted(len(log), 'row')}: too few to judge a model by, {MIN_ROWS} at least"
            raise LogError(few, log.name)
        # What a unit makes of a log is no cause. A dead probe may look so, too.
        for suspect in unit_suspects(found, log.columns):
            if suspect.channel in drives or suspect.unit in ABSOLUTE_UNITS:
                raise LogError(unit_message(suspect), log.name)
        for suspect in course_suspects(found, log):
            raise LogError(unit_message(suspect), log.name)
        for output in found.outputs:
            if output.channel not in log.columns and output.channel not in dead:
                near = hint(output.channel, log.columns)
                told = f"no column {output.channel}{near}"
                if in_another_unit(output.channel, log.columns):
                    raise LogError(told, log.name)
                remarks.append(f"{log.name}: {told}: it is not judged there")
        remarks.extend(range_messages(log, found))
        warn_pauses(log, remarks.append, drives_over_pauses(drive.hold for drive in found.drives))
        return log

    logs, unseen = (tuple(judged(each) for each in several) for several in (all_of(data), validate))
    _check_different([*logs, *unseen])
    calibration = _calibration_logs(found, [*logs, *unseen], reading)
    able = limits_of(limits, [name for log in logs for name in log.columns])
    sound = {log.digest: _without_spikes(log, found, reading)
             for log in (*logs, *unseen, *calibration)}  # fmt: skip
    changed = {digest: switches_in(log, drives, outputs) for digest, log in sound.items()}

    def placed(group: Sequence[Log], say: Notice) -> tuple[Log, ...]:
        return tuple(with_switches(log, changed[log.digest], outputs, say) for log in group)

    logs, unseen = (placed(group, remarks.append) for group in (logs, unseen))
    calibration = placed(calibration, silent)
    sound = dict(zip(sound, placed(list(sound.values()), silent), strict=True))
    for remark in (*unread, *remarks):
        warn(remark)
    diagnosis = run(found, logs, unseen, progress, calibration, able, sound)
    diagnosis = replace(diagnosis, notes=(*diagnosis.notes, *unread))
    progress("done\n")
    given = isinstance(model, str | os.PathLike)
    name = os.path.basename(source_name(os.fspath(model))) if given else "<model>"  # type: ignore[arg-type]
    return DiagnosisReport(diagnosis, name, logs, unseen, calibration, allowed)


def _without_spikes(log: Log, model: Model, reading: Mapping[str, Any]) -> Log:
    """A log as `simulate` reads it: what stands out is a fault of its sensor there."""
    own = {name: reading[name] for name in ("faults", "nan_policy") if name in reading}
    return read(log, model.needs(), warn=silent, **own)


def _typed(tolerance: Tolerance) -> list[str]:
    """Tolerances as they are typed at the command line."""
    if isinstance(tolerance, Mapping):
        return [f"{output}={value}" for output, value in tolerance.items()]
    return [str(tolerance)] if isinstance(tolerance, str | float | int) else list(tolerance)


def _calibration_logs(
    model: Model, given: Sequence[Log], reading: Mapping[str, Any]
) -> tuple[Log, ...]:
    """Logs that the model was calibrated on, where they still are what they were."""
    found, seen = [], {log.digest for log in given}
    outputs = [output.channel for output in model.outputs]
    sources = model.provenance.get("logs")
    for source in sources if isinstance(sources, list | tuple) else ():
        # A document of another program may hold anything here.
        name, digest = (source.get(k) if isinstance(source, Mapping) else None
                        for k in ("name", "sha256"))  # fmt: skip
        if not (isinstance(name, str) and isinstance(digest, str)):
            continue
        if not digest or digest in seen or not os.path.isfile(name):
            continue
        try:
            log = read(name, model.needs(), keep_spikes=outputs, warn=silent, **reading)
            log, _ = _judged_by(log, model)
        except LogError:  # other columns or units than the logs that are diagnosed
            continue
        if log.digest == digest:
            seen.add(digest)
            found.append(log)
    return tuple(found)


def _judged_by(log: Log, model: Model) -> tuple[Log, dict[str, str]]:
    """A log without its dead sensors, and why each has no reading.

    Raises
    ------
    LogError
        No row, no output of the model, or none with a reading, or one without that the model needs.
    """
    import numpy as np

    outputs = [output.channel for output in model.outputs]
    there = [name for name in outputs if name in log.columns]
    if not there:
        near = hint(outputs[0], log.columns) if len(outputs) == 1 else ""
        raise LogError(
            f"no output of the model is in the log: {', '.join(outputs)}{near}", log.name
        )
    if not len(log):
        raise LogError("no rows: nothing to judge the model by", log.name)
    faults = {each.channel: each.message for each in reversed(log.faults)}
    dead = {
        name: f"no reading but faults: {faults[name]}" if name in faults else "no values"
        for name in there
        if np.isnan(log.columns[name]).all()
    }
    if needed := [name for name in dead if name in model.needs()]:
        raise LogError(f"{dead[needed[0]]}: the model needs it", log.name, None, needed[0])
    if len(dead) == len(there):
        first = there[0]
        raise LogError(f"{dead[first]}: nothing to judge the model by", log.name, None, first)
    kept = {name: values for name, values in log.columns.items() if name not in dead}
    return (replace(log, columns=kept) if dead else log), dead


def _check_different(logs: Sequence[Log]) -> None:
    """Refuse a log that is given twice: it would be held out from itself."""
    first: dict[str, Log] = {}
    for log in logs:
        other = first.setdefault(log.digest, log)
        if other is not log:
            raise LogError(f"the same log as {other.name}", log.name)
