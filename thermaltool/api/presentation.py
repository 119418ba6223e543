"""What is in model files, as a person asks for it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thermaltool.api.inputs import all_of, as_model
from thermaltool.api.result import Result
from thermaltool.documents import ARMA, MODEL, read_text, source_name
from thermaltool.errors import ModelError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.inputs import ModelLike
    from thermaltool.model import Model
    from thermaltool.timeseries.model import ArmaModel


@dataclass(frozen=True, repr=False)
class Presentation(Result):
    """Gains, time constants, delays and effects of models.

    Attributes
    ----------
    models : mapping of name to Model or ArmaModel
    """

    models: Mapping[str, Model | ArmaModel]

    def document(self) -> dict[str, Any]:
        """What ``thermaltool present --json`` writes: each model by its name, no covariance."""
        from thermaltool.report.presentation import presented_document

        return {name: presented_document(model) for name, model in self.models.items()}

    def table(self) -> str:
        """Outputs, responses, effects and estimator of each model."""
        from thermaltool.report.presentation import presented

        return "\n\n\n".join(f"{name}\n{presented(m)}" for name, m in self.models.items())

    @property
    def frame(self) -> pandas.DataFrame:
        """Gain and slowest time constant of every response with their intervals, a row each.

        One for each level where it goes by levels.
        """
        import pandas

        from thermaltool.model import Model, at_operating_points

        rows = []
        for name, model in self.models.items():
            if not isinstance(model, Model):
                continue
            for _, _, each in at_operating_points(model):
                empty = (float("nan"),) * 3
                slowest = each.time_constants[:1]
                rows.append((
                    name, each.drive, each.output,
                    each.gain.value, each.gain.low, each.gain.high, each.gain.unit,
                    *next(((t.value, t.low, t.high) for t in slowest), empty), each.delay.value,
                ))  # fmt: skip
        columns = ["model", "drive", "output", "gain", "gain_low", "gain_high", "gain_unit",
                   "slowest_s", "slowest_low_s", "slowest_high_s", "delay_s"]  # fmt: skip
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:3])

    def draw(self) -> Figure:
        """Step, frequency response and poles of one model; the step responses of several."""
        from thermaltool.report.figure import draw_models

        return draw_models(self.models)


def present(models: ModelLike | ArmaModel | Sequence[ModelLike | ArmaModel]) -> Presentation:
    """What is in models: outputs, gains, time constants, delays, effects, estimator.

    Parameters
    ----------
    models : Model, ArmaModel, a result that holds one, str or path, or several of them

    Returns
    -------
    Presentation
        With 95 % intervals where the model has a covariance.

    Raises
    ------
    ModelError
        A file that is neither a model nor an ARMA model.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 1200.0, 10.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": np.where(time < 60, 0.0, 100.0)})
    >>> frame["d_z_um"] = np.where(time < 60, 0.0, 20 * -np.expm1(-(time - 60) / 200))
    >>> fit = tt.calibrate(frame, ["Q_motor_W"], deflections=["d_z_um"])
    >>> tt.present(fit).frame[["gain", "gain_unit", "slowest_s"]].round(3)
                                gain gain_unit  slowest_s
    model   drive     output
    model 1 Q_motor_W d_z_um     0.2      µm/W      200.0
    """
    found: dict[str, Model | ArmaModel] = {}
    for k, each in enumerate(all_of(models), 1):
        if isinstance(each, str | os.PathLike):
            path = os.fspath(each)
            found[source_name(path)] = read_any_model(path)
        else:
            found[f"model {k}"] = as_model(each)
    return Presentation(found)


def read_any_model(path: str) -> Model | ArmaModel:
    """The model in a file: of a machine, or of a series.

    Parameters
    ----------
    path : str
        ``-`` is stdin.

    Raises
    ------
    ModelError
        Neither of them; the message names the file.
    """
    from thermaltool import model
    from thermaltool.parsing import parse_json

    text, name = read_text(path)
    document = parse_json(text, name, f" (not {MODEL.noun})")
    if isinstance(document, dict) and ARMA.matches(document):
        from thermaltool.timeseries.model import loads

        return loads(text, name)
    if not isinstance(document, dict) or not MODEL.matches(document):
        raise ModelError(f"{name}: neither {MODEL.noun} nor {ARMA.noun}")
    return model.loads(text, name)
