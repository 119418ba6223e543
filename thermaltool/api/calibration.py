"""Logs in, a calibrated model out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.inputs import Reading, all_of, read_for_fit, reads
from thermaltool.api.pauses import placed_in_pauses
from thermaltool.api.result import Notice, Result, notice, silent
from thermaltool.units import names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.fitting.calibration_plan import CalibrationPlan
    from thermaltool.fitting.components.reduction import Reduction
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.units import Reference

# What outliers count, and how many starts of the search are refined, where nothing is said.
USUAL_LOSS: Literal["huber"] = "huber"
USUAL_STARTS = 6


@dataclass(frozen=True, repr=False)
class Calibration(Result):
    """A model, and the logs that it was fitted to.

    Attributes
    ----------
    model : Model
    logs : tuple of Log
    """

    model: Model
    logs: tuple[Log, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the logs leave open, each a sentence."""
        from thermaltool.report.calibration import calibration_warnings

        return tuple(calibration_warnings(self.model))

    @property
    def frame(self) -> pandas.DataFrame:
        """Fitted parameters with their standard errors, one row each; NaN where fixed."""
        import pandas

        from thermaltool.responses import parameter_names

        rows = []
        for term in self.model.terms:
            names = list(term.covariance_names)
            for name in parameter_names(term.response.kind):
                k = names.index(name) if name in names else None
                variance = float("nan") if k is None else float(term.covariance[k, k])  # type: ignore[index]
                value = getattr(term.response, name)
                rows.append((term.output, term.drive, name, value, variance**0.5))
        columns = ["output", "drive", "parameter", "value", "standard_error"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:3])

    def document(self) -> dict[str, Any]:
        """Outputs and terms as the model file has them."""
        from thermaltool.report.calibration import calibration_document

        return calibration_document(self.model)

    def exceeds(self, rmse: float) -> bool:
        """Whether the RMSE of an output that is judged is above this [unit of the output]."""
        return any(output.fit["rmse"] > rmse for output in self.model.outputs if output.judged)

    def table(self) -> str:
        """Each output with its fit and its responses."""
        from thermaltool.report.calibration import calibration_table

        return calibration_table(self.model)

    def draw(self) -> Figure:
        """Measured and simulated outputs over the first log, and their difference."""
        from thermaltool.report.residuals import draw_comparison

        return draw_comparison(self.model, self.logs[0])


@reads(Reading)
def calibrate(
    data: Data | Sequence[Data],
    drives: str | Sequence[str],
    *,
    sensors: str | Sequence[str] = (),
    deflections: str | Sequence[str] = (),
    kinds: Mapping[str, str] | None = None,
    fixed: Mapping[str, float] | None = None,
    reference: Reference | None = None,
    initial: Literal["auto", "rest", "free"] = "auto",
    start: float | None = None,
    stop: float | None = None,
    loss: Literal["huber", "linear"] = USUAL_LOSS,
    starts: int = USUAL_STARTS,
    linear: bool = False,
    reduce: str | None = None,
    joint: str | Sequence[str] = (),
    warn: Notice = notice,
    progress: Notice = silent,
    **reading: Unpack[Reading],
) -> Calibration:
    """Fit temperature and deflection models to measured logs.

    Any input will do, not only a step; several logs are fitted together. Of more than 100 000 rows
    averages are fitted, and told.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
    drives : str or sequence of str
        Known inputs: a heat, a voltage, or any measured channel.
    sensors : str or sequence of str
        Outputs from which the drive will be estimated.
    deflections : str or sequence of str
        Outputs that will be computed.
    kinds : mapping of output to kind of response, optional
        Default: of all kinds (`conduction`, `slab` and `rod` for one drive, `deflection`,
        `joint_deflection`, sums of one to four lags with a delay or without) the one that evidence
        and held-out rows speak for.
    fixed : mapping of parameter to value, optional
        Parameters that are not fitted.
    reference : "first" or float, optional
        What counts as no drive. Default: "first" for an absolute temperature, else 0.
    initial : {"auto", "rest", "free"}
        State at the first row: at rest, coming from an unknown level, or, by default, the latter
        where that leaves far less.
    start, stop : float, optional [s]
        The stretch that is fitted.
    loss : {"huber", "linear"}
        Huber counts outliers less.
    starts : int
        Starts of the search that are refined.
    linear : bool
        Take every drive as it is logged, and the material as it is at rest. Default: where evidence
        and held-out rows speak for it, a power law or a parabola of a drive, or a heat capacity
        that changes with temperature, is part of the model.
    reduce : {"pca", "pls", "none", "pca:k", "pls:k"}, optional
        Many drives that say much the same, directly and through lags: components of the scaled
        drives, with a ridge, as `identify` has them. The model takes the drives as they are
        measured.
    joint : str or sequence of str
        Contact temperatures of a joint. The logs have several levels: responses are fitted to
        the middle one, the displacements of the others say what the joint does, told by how far
        these temperatures depart from the linear model and by a bend with the first temperature
        among `sensors`. Those that say nothing more are left out.
    warn, progress : callable
        Take a sentence where a log pauses, and a word now and then.
    **reading
        See `read_log`.

    Returns
    -------
    Calibration

    Raises
    ------
    LogError
        A log that cannot be read, lacks a channel or has fewer than two rows.
    ModelError
        Nothing to fit, a channel in two roles, an unknown kind or parameter.
    ValueError
        A reduction that is none, or arguments that go without it.
    FitError
        No fit on these data.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> round(fit.model.terms[0].response.dc_gain(), 3)
    0.2
    """
    from thermaltool.fitting.averaging import averaged_rows
    from thermaltool.fitting.calibrate import calibrate as fit
    from thermaltool.fitting.calibration_plan import CalibrationPlan
    from thermaltool.report.text import repeated_messages

    drives, sensors, deflections = names(drives), names(sensors), names(deflections)
    contacts = names(joint)
    plan = CalibrationPlan(
        drives,
        sensors,
        deflections,
        kinds or {},
        reference,
        None,
        fixed or {},
        loss,
        starts,
        initial,
        choose=True,
        linear=linear,
    )
    outputs = (*sensors, *deflections, *contacts)
    reduction = check_reduce(reduce, len(drives), kinds=kinds, fixed=fixed, linear=linear,
                             loss=loss, starts=starts, joint=contacts)  # fmt: skip
    logs = [
        read_for_fit(each, drives, "response", (start, stop), outputs=outputs, warn=warn, **reading)
        for each in all_of(data)
    ]
    for message in repeated_messages(logs):
        warn(message)
    if reduction is not None:
        return _reduced(logs, plan, reduction, warn)
    for log, rows in zip(logs, averaged_rows(logs), strict=True):
        if rows > 1:
            count = f"{len(log):,}".replace(",", " ")
            warn(f"{log.name}: {count} rows: every {rows} are averaged for the fit")
    logs = [placed_in_pauses(log, drives, outputs, warn) for log in logs]
    if contacts:
        from thermaltool.fitting.joint_sources import calibrate_joint

        found = calibrate_joint(logs, plan, contacts, progress)
        model = found.model
        for channel in found.left_out:
            warn(f"{channel}: left out: it says nothing more of the joint")
    else:
        model = fit(logs, plan, progress)
    progress("done\n")
    return Calibration(model, tuple(logs))


def _reduced(
    logs: Sequence[Log], plan: CalibrationPlan, reduction: Reduction, warn: Notice
) -> Calibration:
    """A calibration by components of the drives; says what `identify` says of such logs."""
    from thermaltool.api.identification_arguments import COMPONENTS
    from thermaltool.api.identification_plans import check_clock, warn_holes
    from thermaltool.fitting.reduced import calibrate_reduced
    from thermaltool.report.components import component_warnings, given_components

    for log in logs:
        check_clock(log, logs[0].period, warn)
        warn_holes(log, plan.drives, (*plan.sensors, *plan.deflections), COMPONENTS, warn)
    model, fits = calibrate_reduced(logs, plan, reduction)
    for sentence in (given_components(fits), *component_warnings(fits)):
        warn(sentence)
    return Calibration(model, tuple(logs))


def check_reduce(
    reduce: str | None,
    drives: int,
    *,
    kinds: Mapping[str, str] | None = None,
    fixed: Mapping[str, float] | None = None,
    linear: bool = False,
    loss: str = USUAL_LOSS,
    starts: int = USUAL_STARTS,
    joint: Sequence[str] = (),
) -> Reduction | None:
    """The reduction of so many drives, beside which nothing else is chosen; None for none.

    Raises
    ------
    ValueError
        It is none, or arguments that components do not have; named as options of the command.
    """
    if reduce is None:
        return None
    from thermaltool.api.identification_arguments import check_reduction

    given = {"--response": kinds, "--fix": fixed, "--linear": linear,
             "--loss": loss != USUAL_LOSS, "--starts": starts != USUAL_STARTS,
             "--joint": joint}  # fmt: skip
    for name, value in given.items():
        if value:
            raise ValueError(f"{name} does not go with --reduce, which takes lags and a ridge")
    return check_reduction(reduce, drives, "drives")
