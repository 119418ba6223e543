"""From columns to what is told: readings, estimator, and the effects around it.

The batch command runs a whole log through `Chain.run`; the stream takes the same inlets, the same
recursion and the same last step, sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermaltool.effects.band import Band
from thermaltool.errors import ModelError
from thermaltool.estimation.estimator import (
    Estimator,
    KalmanEstimator,
    load_estimator,
    run_estimator,
)
from thermaltool.estimation.known import Known, WithKnown
from thermaltool.estimation.losses import LossyEstimator, losses_of
from thermaltool.estimation.standing import (
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
class Feed:
    """One input of the estimator.

    Attributes
    ----------
    inlet : int
        The column from which it comes.
    band : Band or None
        Only this level's share of it,
    by : int
        by what this inlet reads.
    """

    inlet: int
    band: Band | None = None
    by: int = 0


@dataclass(frozen=True)
class Chain:
    """A model's estimator with all that is around it.

    Attributes
    ----------
    estimator : Estimator
    inlets : tuple of Inlet
        One for each column that is read, the sensors first.
    feeds : tuple of Feed
        What the estimator takes, in the order of ``estimator.sensors``.
    told : tuple of tuple of callable
        For each estimate, the steps from it to what is told.
    """

    estimator: Estimator
    inlets: tuple[Inlet, ...]
    feeds: tuple[Feed, ...]
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
        feeds = [Feed(k) for k in range(len(inlets))]
        if isinstance(linear, WithKnown):
            added, taken = _known_inlets(model, linear.known, len(inlets))
            inlets += added
            feeds += taken
        told = tuple(told_of(model, name) for name in linear.estimates)
        return Chain(_with_losses(model, linear), tuple(inlets), tuple(feeds), told)

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
        acting = [through(inlet.ahead, truths[:, k]) for k, inlet in enumerate(self.inlets)]
        inputs = np.empty((len(truths), len(self.feeds)))
        for k, feed in enumerate(self.feeds):
            share = 1.0 if feed.band is None else feed.band.share(truths[:, feed.by])
            inputs[:, k] = acting[feed.inlet] * share
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
        acting = [_at_once(each, value) for each, value in zip(steps, truths, strict=True)]
        return [
            acting[feed.inlet]
            if feed.band is None
            else acting[feed.inlet] * float(feed.band.share(np.array(truths[feed.by])))
            for feed in self.feeds
        ]

    @property
    def straight(self) -> bool:
        """Whether the estimator takes the truths as they are."""
        bent = any(inlet.ahead for inlet in self.inlets)
        return not bent and all(feed.band is None for feed in self.feeds)

    def tell(self, estimates: Sequence[float]) -> list[float]:
        """What is told of the estimates of one sample."""
        return [_at_once(each, value) for each, value in zip(self.told, estimates, strict=True)]


def _at_once(steps: tuple[Static, ...], value: float) -> float:
    return float(through(steps, np.array(value))) if steps else value


def _known_inlets(
    model: Model, known: Sequence[Known], first: int
) -> tuple[list[Inlet], list[Feed]]:
    """Inlets of known columns, each in each role once, and what they feed; numbered from `first`.

    Raises
    ------
    ModelError
        A schedule by a channel that is not read.
    """
    places: dict[tuple[str, str], int] = {}
    inlets: list[Inlet] = []
    for each in known:
        if (each.channel, each.role) not in places:
            places[each.channel, each.role] = first + len(inlets)
            inlets.append(_known_inlet(model, each))
    feeds = []
    for each in known:
        inlet, by = places[each.channel, each.role], 0
        if each.band is not None:
            chooser = each.band.channel
            at = places.get((chooser, "drive"), places.get((chooser, "state")))
            if at is None:
                raise ModelError(f"the schedule by {chooser} has no column: run regularize again")
            by = at
        feeds.append(Feed(inlet, each.band, by))
    return inlets, feeds


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
