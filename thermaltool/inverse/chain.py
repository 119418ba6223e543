"""From columns to what is told: readings, estimator, and the effects around it.

The batch command runs a whole log through `Chain.run`; the stream takes the same inlets, the same
recursion and the same last step, sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.errors import ModelError
from thermaltool.inverse.estimator import (
    Estimator,
    KalmanEstimator,
    load_estimator,
    run_estimator,
)
from thermaltool.inverse.known import Known, WithKnown
from thermaltool.inverse.losses import LossyEstimator, losses_of
from thermaltool.inverse.standing import (
    Inlet,
    Static,
    ahead_of,
    back_of,
    columns_of,
    through,
    told_of,
)
from thermaltool.model import Model, relative
from thermaltool.responses.modes import Float


@dataclass(frozen=True)
class Chain:
    """A model's estimator with all that is around it.

    Attributes
    ----------
    estimator : Estimator
    inlets : tuple of Inlet
        In the order of ``estimator.sensors``.
    told : tuple of tuple of callable
        For each estimate, the steps from it to what is told.
    """

    estimator: Estimator
    inlets: tuple[Inlet, ...]
    told: tuple[tuple[Static, ...], ...]

    @staticmethod
    def of(model: Model) -> Chain:
        """The chain that a model's design asks for.

        Raises
        ------
        ModelError
            No design, one for other parameters, or one that is not sound.
        """
        design = model.estimator_design()
        linear = load_estimator(dict(design))
        columns, outputs = columns_of(model), {o.channel: o for o in model.outputs}
        inlets = [
            Inlet(
                columns[sensor],
                outputs[columns[sensor]].offset,
                outputs[sensor].range,
                True,
                back=back_of(model, sensor),
            )
            for sensor in design["sensors"]
        ]
        if isinstance(linear, WithKnown):
            inlets += [_known_inlet(model, known) for known in linear.known]
        told = tuple(told_of(model, name) for name in linear.estimates)
        return Chain(_with_losses(model, linear), tuple(inlets), told)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that are read."""
        return tuple(inlet.column for inlet in self.inlets)

    def truths(self, columns: Mapping[str, Float]) -> Float:
        """What is behind the columns, relative to rest; NaN where a reading has no truth.

        Returns
        -------
        ndarray, shape (n, n_inlets)
        """
        found = [through(i.back, relative(columns[i.column], i.rest)) for i in self.inlets]
        return np.column_stack(found)

    def run(self, time: Float, truths: Float, settled: bool = False) -> Float:
        """What is told of a whole record, equal to the stream's sample by sample.

        Parameters
        ----------
        time : ndarray, shape (n,) [s], increasing
        truths : ndarray, shape (n, n_inlets)
        settled : bool
            The machine has stood at the first readings for long; else it is at rest there.

        Returns
        -------
        ndarray, shape (n, n_estimates)
        """
        inputs = truths.copy()
        for k, inlet in enumerate(self.inlets):
            inputs[:, k] = through(inlet.ahead, truths[:, k])
        if isinstance(self.estimator, LossyEstimator):
            estimates = self.estimator.run(time, inputs, settled)
        else:
            estimates = run_estimator(self.estimator, time, inputs, settled)
        for k, steps in enumerate(self.told):
            estimates[:, k] = through(steps, estimates[:, k])
        return estimates

    def inputs(self, truths: Sequence[float]) -> list[float]:
        """What acts of the truths of one sample."""
        steps = (inlet.ahead for inlet in self.inlets)
        return [_at_once(each, value) for each, value in zip(steps, truths, strict=True)]

    def tell(self, estimates: Sequence[float]) -> list[float]:
        """What is told of the estimates of one sample."""
        return [_at_once(each, value) for each, value in zip(self.told, estimates, strict=True)]


def _at_once(steps: tuple[Static, ...], value: float) -> float:
    return float(through(steps, np.array(value))) if steps else value


def _known_inlet(model: Model, known: Known) -> Inlet:
    if known.role == "source":
        return Inlet(known.channel, "first", None, False, known.hold == "zero")
    if known.role == "state":
        return Inlet(known.channel, 0.0, None, False, True)
    for drive in model.drives:
        if drive.channel == known.channel:
            ahead = ahead_of(model, drive.channel)
            return Inlet(
                drive.channel, drive.reference, drive.range, False, drive.hold == "zero", (), ahead
            )
    raise ModelError(
        f"the estimator reads the drive {known.channel}, which the model does not have: "
        "run thermaltool regularize again"
    )


def _with_losses(model: Model, linear: Estimator) -> Estimator:
    losses = losses_of(model)
    if not losses:
        return linear
    kalman = linear.inner if isinstance(linear, WithKnown) else linear
    if not isinstance(kalman, KalmanEstimator):
        raise ModelError(
            f"{losses[0].name} takes the Kalman form: run thermaltool regularize again"
        )
    return LossyEstimator(linear, kalman, losses)
