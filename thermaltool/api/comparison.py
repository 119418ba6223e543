"""Models side by side on one log."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

from thermaltool.api.inputs import Reading, all_of, as_model, reads
from thermaltool.api.result import Notice, Result, notice
from thermaltool.api.simulation import Simulation, simulate
from thermaltool.documents import source_name
from thermaltool.errors import LogError, ModelError
from thermaltool.files import file_names
from thermaltool.logs import read_log

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.inputs import ModelLike
    from thermaltool.logs.reader import Data
    from thermaltool.model import Start
    from thermaltool.signals.agreement import Agreement


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Several models, simulated over one log.

    Attributes
    ----------
    simulations : mapping of name to Simulation
        What `simulate` gives for each model.
    outputs : tuple of str
        Measured channels that all models compute: these are compared.
    notes : tuple of str
        What is left out, and what outputs count from, a sentence each.
    """

    simulations: Mapping[str, Simulation]
    outputs: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Agreement of each model, as ``simulate --json`` has it, by output and model."""
        found = {name: run.document() for name, run in self.simulations.items()}
        return {output: {name: found[name][output] for name in found} for output in self.outputs}

    @property
    def agreements(self) -> dict[str, dict[str, Agreement]]:
        """How far each model is from what was measured, by output and model."""
        runs = self.simulations.items()
        return {o: {name: run.agreements[o] for name, run in runs} for o in self.outputs}

    def table(self) -> str:
        """RMSE and fit of every model, output by output."""
        from thermaltool.report.simulation import comparison_table

        return comparison_table(self.agreements)

    @property
    def frame(self) -> pandas.DataFrame:
        """RMSE, RMSE with a free zero and fit, one row for each output and model."""
        import pandas

        rows = [
            (output, name, a.rmse, a.rmse_zero_free, a.fit_percent, a.max_error)
            for output, found in self.agreements.items()
            for name, a in found.items()
        ]
        columns = ["output", "model", "rmse", "rmse_zero_free", "fit_percent", "max_error"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:2])

    def draw(self) -> Figure:
        """Measured and simulated outputs, and the residuals of each model."""
        from thermaltool.report.comparison import ModelCurve, draw_curves_of_models

        curves = {
            output: [
                ModelCurve(name, run.log, run.computed(output), run.zeros[output].value,
                           run.columns[f"residual_{output}"], run.agreements[output])
                for name, run in self.simulations.items()
            ]
            for output in self.outputs
        }  # fmt: skip
        return draw_curves_of_models(curves)


@reads(Reading)
def compare(
    models: ModelLike | Sequence[ModelLike],
    data: Data,
    *,
    initial: Start = "auto",
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> Comparison:
    """Models side by side on one log: each is simulated as `simulate` does it.

    Parameters
    ----------
    models : Model, a result that holds one, str or path, or several of them
    data : str, path, pandas.DataFrame or Record
    initial, start, stop, warn, **reading
        As for `simulate`.

    Returns
    -------
    Comparison

    Raises
    ------
    LogError
        As `simulate`; no output of the models was measured.
    ModelError
        A file that is no model; models without an output in common.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fits = [tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"], kinds={"d_z_um": kind})
    ...         for kind in ("rational1", "rational2")]
    >>> tt.compare(fits, frame).frame["fit_percent"].round(1).tolist()
    [100.0, 100.0]
    """
    from thermaltool.report.comparison import common_outputs

    found = {name: as_model(model) for name, model in _named(all_of(models)).items()}
    common = common_outputs({n: [o.channel for o in m.outputs] for n, m in found.items()})
    # A pipe is read once; each model then says which of its columns must be there.
    if isinstance(data, str) and data == "-":
        columns, source = reading.pop("columns", None), reading.pop("from_format", None)
        data = read_log(data, columns=columns, from_format=source,
                        duplicates=reading.pop("duplicates", None))  # fmt: skip
    told: dict[str, None] = {}
    runs = {}
    for name, model in found.items():
        try:
            runs[name] = simulate(model, data, initial=initial, start=start, stop=stop,
                                  warn=told.setdefault, **reading)  # fmt: skip
        except ModelError as error:
            raise ModelError(f"{name}: {error}") from error
        except LogError as error:
            # The log may lack what this model alone reads.
            lacks = any(f"no column {channel}" in str(error) for channel in model.needs())
            raise LogError(f"{error}, which {name} needs") if lacks else error from error
    for message in told:
        warn(message)
    outputs = tuple(c for c in common if all(c in run.agreements for run in runs.values())
                    and all(run.agreements[c].rows for run in runs.values()))  # fmt: skip
    if not outputs:
        log = next(iter(runs.values())).log
        raise LogError(f"no measured output of the models ({', '.join(common)})", log.name)
    return Comparison(runs, outputs, tuple(_notes(runs, outputs)))


def _named(models: Sequence[ModelLike]) -> dict[str, ModelLike]:
    """Models by the names of their files, those that have none by their place."""
    paths = [
        source_name(os.fspath(m)) if isinstance(m, str | os.PathLike) else f"model {k}"
        for k, m in enumerate(models, 1)
    ]
    return dict(zip(file_names(paths), models, strict=True))


def _notes(runs: Mapping[str, Simulation], outputs: Sequence[str]) -> Iterator[str]:
    """What is left out, and what each model's outputs count from."""
    from thermaltool.report.text import start_message, zero_message

    computed = dict.fromkeys(o.channel for run in runs.values() for o in run.model.outputs)
    if left_out := [name for name in computed if name not in outputs]:
        yield f"{', '.join(left_out)}: not in all models or not measured: left out"
    warm = [name for name, run in runs.items() if run.from_rest]
    for name in warm:
        rmse = {output: each.rmse for output, each in runs[name].from_rest.items()}
        yield f"{name}: {start_message(runs[name].log, rmse)}"
    if 0 < len(warm) < len(runs):
        yield "the models begin differently: --initial rest or free compares them alike"
    for name, run in runs.items():
        for output in outputs:
            if run.zeros[output].rows:
                yield f"{name}: {zero_message(output, run.zeros[output], run.log)}"
