"""From a model with an estimator to a controller of heaters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from thermaltool.api.inputs import as_model
from thermaltool.api.result import Notice, Result, notice
from thermaltool.units import names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.inputs import ModelLike
    from thermaltool.control.design import ControlDesign


@dataclass(frozen=True, repr=False)
class ControlReport(Result):
    """A controller, and how it does on its own model.

    Attributes
    ----------
    design : ControlDesign
        With the ``controller``, whose ``document()`` is what `compensate` runs.
    """

    design: ControlDesign

    @property
    def notes(self) -> tuple[str, ...]:
        """Heat that would have to be taken away, and what would help, each a sentence."""
        from thermaltool.report.control import control_notes

        return control_notes(self.design)

    @property
    def frame(self) -> pandas.DataFrame:
        """Bands of every output after a step of every disturbance [unit of the output]."""
        import pandas

        from thermaltool.report.control import band

        rows = [
            {
                "disturbance": trial.disturbance,
                "level": trial.level,
                "duration_s": float(trial.time[-1]),
                "output": output,
                "without": band(trial.free[output]),
                "held": band(trial.held[output]),
                "at_limit": trial.at_limit,
            }
            for trial in self.design.trials
            for output in trial.held
        ]
        return pandas.DataFrame(rows)

    def document(self) -> dict[str, Any]:
        """Controller and trials, without the model, JSON-ready."""
        from thermaltool.report.control import control_document

        return control_document(self.design)

    def table(self) -> str:
        """The bands, and the limits that were kept."""
        from thermaltool.report.control import control_table

        return control_table(self.design)

    def draw(self) -> Figure:
        """Outputs and heats after the step that is held worst."""
        from thermaltool.report.control import draw_control

        return draw_control(self.design)


def design(
    model: ModelLike,
    control: str | Sequence[str] | Mapping[str, float | None],
    *,
    method: Literal[
        "receding-horizon", "output-lqr", "state-lqr", "inversion"
    ] = "receding-horizon",
    outputs: str | Sequence[str] = (),
    tolerance: Mapping[str, float] | None = None,
    slew: float = 10.0,
    horizon: float | None = None,
    duration: float | None = None,
    lead: float | None = None,
    axes: Mapping[str, float] | None = None,
    warn: Notice = notice,
) -> ControlReport:
    """Design a controller of heaters.

    Parameters
    ----------
    model : Model, a result that holds one, str or path
        With an estimator that reads each control drive (`regularize` with `measured`).
    control : str, sequence of str, or mapping of str to float
        Drives that are set, with the largest value of each; None for what the calibration has seen.
    method : {"receding-horizon", "output-lqr", "state-lqr", "inversion"}
        Heats planned within the limits, linear quadratic regulators scaled by Bryson's rule, or
        feed-forward by inversion of the model.
    outputs : str or sequence of str
        Deflections that are held at zero. Default: all.
    tolerance : mapping of output to float [unit of the output], optional
        Deviation that counts as much as one of this size of another output, and for a regulator as
        full power. Default: 1 % of the range that the calibration has seen.
    slew : float [unit of the drive per s]
        Largest rate of a setpoint.
    horizon : float, optional [s]
        How far heats are planned. Default: the slowest time constant of the control drives.
    duration : float, optional [s]
        How long the machine works: the plan ends there.
    lead : float, optional [s]
        When the inversion is at zero. Default: two sample periods.
    axes : mapping of output to float [unit of the output], optional
        What an NC axis corrects of a deflection, up and down: heat is planned for what goes beyond
        (receding horizon alone), and `compensate` writes the offset of the axis, too.
    warn : callable
        Takes a sentence about heat that no heater gives.

    Returns
    -------
    ControlReport

    Raises
    ------
    ModelError
        A drive or output that the model does not have, or that nothing acts on; limits that leave
        no power; an estimator that does not read the power.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time, heat = np.arange(0.0, 3000.0, 10.0), np.zeros((2, 300))
    >>> heat[0, 6:150], heat[1, 150:] = 100.0, 90.0
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": heat[0], "Q_pad_W": heat[1]})
    >>> step = -np.expm1(-time / 200)
    >>> effect = np.convolve(np.diff(heat[0], prepend=0), step)[:300]
    >>> frame["d_z_um"] = 0.2 * effect - 0.3 * np.convolve(np.diff(heat[1], prepend=0), step)[:300]
    >>> fit = tt.calibrate(frame, ["Q_motor_W", "Q_pad_W"], deflections=["d_z_um"])
    >>> report = tt.design(tt.regularize(fit), {"Q_pad_W": 90.0}, method="output-lqr")
    >>> report.frame[["without", "held"]].round(1).iloc[0].tolist()
    [12.6, 0.0]
    """
    from thermaltool.control.design import ControlPlan, design_controller

    drives = control if isinstance(control, Mapping) else dict.fromkeys(names(control))
    plan = ControlPlan(
        tuple(drives.items()),
        method,
        names(outputs),
        tolerance or {},
        slew,
        horizon,
        lead,
        duration,
        axes or {},
    )
    report = ControlReport(design_controller(as_model(model), plan))
    for sentence in report.notes:
        warn(sentence)
    return report
