"""A declared body and logs in, an updated model out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from thermaltool.api.body_modes import finite_elements
from thermaltool.api.inputs import Reading, all_of, read, read_for_fit, reads, refuse_unread
from thermaltool.api.result import Notice, Result, notice

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.body_modes import BodyLike
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.placement.updating import BodyParameter


@dataclass(frozen=True, repr=False)
class BodyCalibration(Result):
    """A finite-element model that was updated from logs.

    Attributes
    ----------
    model : Model
        Every heat into every point and deflection, by few modes of the updated mesh.
    parameters : tuple of BodyParameter
        Of the body, declared and by the logs.
    logs : tuple of Log
    noise : mapping of output to float [unit of the output]
        White noise of its readings.
    settled : bool
        Whether the weights of the outputs came to rest.
    """

    model: Model
    parameters: tuple[BodyParameter, ...]
    logs: tuple[Log, ...]
    noise: Mapping[str, float]
    settled: bool = True

    @property
    def notes(self) -> tuple[str, ...]:
        """What the logs leave open, and how far the model is from the mesh, each a sentence."""
        from thermaltool.report.body_calibration import NOT_SETTLED, update_notes

        notes = update_notes(self.parameters, self.model, self.noise)
        return tuple(notes if self.settled else [NOT_SETTLED, *notes])

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each parameter: declared, estimate, interval of 95 %."""
        import pandas

        rows = [
            (p.kind, p.name, p.declared, p.estimate.value, p.estimate.low, p.estimate.high)
            for p in self.parameters
        ]
        columns = ["kind", "name", "declared", "value", "low", "high"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:2])

    def document(self) -> dict[str, Any]:
        """As ``calibrate --body --json`` writes it."""
        from thermaltool.report.body_calibration import update_document

        return update_document(self.parameters, self.model)

    def table(self) -> str:
        """Each parameter, and each output with its fit."""
        from thermaltool.report.body_calibration import update_table

        return update_table(self.parameters, self.model)

    def draw(self) -> Figure:
        """Measured and simulated outputs over the first log, and their difference."""
        from thermaltool.report.residuals import draw_comparison

        return draw_comparison(self.model, self.logs[0])

    def exceeds(self, rmse: float) -> bool:
        """Whether an output's RMSE is above this [unit of the output]."""
        return any(output.fit.get("rmse", 0.0) > rmse for output in self.model.outputs)


@reads(Reading)
def calibrate_body(
    body: BodyLike,
    data: Data | Sequence[Data],
    *,
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> BodyCalibration:
    """Update a finite-element model from logs: films, conductivities, heat that enters, expansion.

    What is declared counts as known before: films to a factor of 2, conductivities and expansions
    to 10 %, the share of a heat that enters to 20 %. The logs say the rest.

    Parameters
    ----------
    body : str, path or mapping
        See `thermal_modes`.
    data : str, path, pandas.DataFrame, Record, or a sequence of them
        With every heat, and some of the points and deflections; each begins at rest.
    start, stop : float, optional [s]
        The stretch that is fitted; `start` is at rest.
    warn : callable
        Takes a sentence where a log pauses.
    **reading
        See `read_log`.

    Returns
    -------
    BodyCalibration

    Raises
    ------
    LogError
        A log that cannot be read, lacks a heat or has fewer than two rows.
    ModelError
        As `thermal_modes`.
    FitError
        No log has readings of a point or deflection of the body, or one of these is constant.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> frame = pd.DataFrame({"time_s": np.arange(0.0, 7200.0, 30.0), "Q_motor_W": 500.0})
    >>> frame["T_1_degC"] = 20 + 12 * -np.expm1(-frame["time_s"] / 5000)
    >>> found = tt.calibrate_body("data_samples/bodies/rod.toml", frame)
    >>> [parameter.name for parameter in found.parameters]
    ['body', 'side', 'Q_motor_W']
    """
    from thermaltool.errors import ModelError
    from thermaltool.model import agreements
    from thermaltool.placement.reduction import reduced_model
    from thermaltool.placement.thermal_modes import thermal_modes
    from thermaltool.placement.updating import update_body
    from thermaltool.signals.detrend import difference_sigma

    elements, name, source = finite_elements(body)
    declared = elements.body
    heats, every = tuple(declared.heat), (*declared.points, *declared.deflections)
    # Which of the outputs there are the logs themselves say.
    given: dict[str, Any] = {**reading, "faults": "keep"}
    whole = [read(each, warn=warn, unread=True, **given) for each in all_of(data)]
    whole = refuse_unread(whole, [*heats, *every], warn)
    own: dict[str, Any] = {k: v for k, v in reading.items() if k not in ("columns", "from_format")}
    logs = [
        read_for_fit(log, heats, "body", (start, stop), warn=warn, **own,
                     outputs=[name for name in every if name in log.columns])
        for log in whole
    ]  # fmt: skip
    try:
        updated = update_body(elements, logs)
    except ModelError as error:
        raise ModelError(f"{source}: {error}") from error
    provenance = {"body": name, "logs": [log.source for log in logs if log.digest]}
    model = reduced_model(thermal_modes(updated.equations), declared, provenance)
    outputs, noise = [], {}
    for output in model.outputs:
        read_in = [log for log in logs if output.channel in log.columns
                   and np.isfinite(log.column(output.channel)).any()]  # fmt: skip
        if read_in:
            found = agreements(model, read_in, [output])[output.channel].document()
            noise[output.channel] = max(
                difference_sigma(log.column(output.channel)) for log in read_in
            )
            output = replace(output, fit={**output.fit, **found})
        outputs.append(output)
    return BodyCalibration(
        replace(model, outputs=tuple(outputs)),
        updated.parameters,
        tuple(logs),
        noise,
        updated.settled,
    )
