"""Logs in, identified transfer functions out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Unpack

from thermaltool.api.identification_arguments import (
    COMPONENTS,
    NETWORK,
    USUAL,
    Orders,
    check_arguments,
)
from thermaltool.api.identification_plans import (
    check_clock,
    plans_of,
    structure_name,
    warn_holes,
    without_bursts,
)
from thermaltool.api.inputs import (
    Reading,
    all_of,
    drives_over_pauses,
    options_of,
    read_for_fit,
    reads,
)
from thermaltool.api.result import Notice, Result, notice, silent
from thermaltool.units import hold_of, names

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.fitting.fit import Fit
    from thermaltool.fitting.screening import LeftOut
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model
    from thermaltool.record import Record
    from thermaltool.units import Reference


@dataclass(frozen=True, repr=False)
class Identification(Result):
    """Identified models, and the logs that they were fitted to.

    Attributes
    ----------
    fits : tuple of Fit
        Each output with its parameters, covariance, criteria and tests of residuals.
    logs : tuple of Log
    reference : "first", float or None
        What counts as no input in the model document.
    reading : tuple of str
        Options with which the logs were read.
    left_out : tuple of LeftOut
        Inputs that no output follows, as far as the data show.
    """

    fits: tuple[Fit, ...]
    logs: tuple[Log, ...]
    reference: Reference | None = None
    reading: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @cached_property
    def model(self) -> Model:
        """The model document: every response in continuous time.

        Raises
        ------
        ModelError
            A response has no form in continuous time.
        """
        from thermaltool.fitting.document import model_document
        from thermaltool.fitting.seen_changes import with_seen_changes

        provenance = {"logs": [x.source for x in self.logs]}
        return with_seen_changes(model_document(self.fits, self.reference, provenance), self.logs)

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the models, each a sentence."""
        from thermaltool.report.identification import identification_warnings

        return tuple(identification_warnings(self.fits, self.left_out))

    @property
    def model_notes(self) -> tuple[str, ...]:
        """What the model document loses of the fits, each a sentence; raises as `model`."""
        from thermaltool.report.identification import document_warnings

        return tuple(document_warnings(self.fits, self.model))

    @property
    def frame(self) -> pandas.DataFrame:
        """Fitted parameters with their 95 % intervals, one row each."""
        import pandas

        rows = [
            (fit.model.target, name, e.value, e.low, e.high)
            for fit in self.fits
            for name, e in fit.parameters.items()
        ]
        columns = ["output", "parameter", "value", "low", "high"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:2])

    @property
    def predicts(self) -> bool:
        """Whether every model predicts its validation data better than their mean does."""
        return all(fit.validation is None or fit.validation.predicts for fit in self.fits)

    def document(self) -> dict[str, Any]:
        """The models as ``identify --json`` writes them."""
        from thermaltool.report.identification import identification_document

        return identification_document(self.fits, self.left_out)

    def table(self) -> str:
        """Fits, gains and time constants with their intervals, and what is left."""
        from thermaltool.report.identification import identification_table

        return identification_table(self.fits, self.reading)

    def draw(self) -> Figure:
        """Measured and simulated outputs over the first log, and their difference."""
        from thermaltool.report.residuals import draw_comparison

        return draw_comparison(self.model, self.logs[0])


@reads(Reading)
def identify(
    data: Data | Sequence[Data],
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    *,
    structure: str | None = None,
    reduce: str | None = None,
    orders: Sequence[Orders | None] = (),
    modes: int | None = None,
    delay: float | Literal["auto"] | None = None,
    noise_orders: tuple[int, int] | None = None,
    continuous: bool = False,
    real_poles: bool | None = None,
    initial: Literal["auto", "rest", "free"] = "auto",
    split: float | None = None,
    validate: Data | None = None,
    reference: Reference | None = None,
    start: float | None = None,
    stop: float | None = None,
    budget: float | None = None,
    warn: Notice = notice,
    progress: Notice = silent,
    **reading: Unpack[Reading],
) -> Identification:
    """Transfer functions from measured logs, one for each output with all inputs.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
    inputs : str or sequence of str
        What drives: power, speed, temperature.
    outputs : str or sequence of str
        What follows: displacement, angle, temperature.
    structure : {"oe", "bj", "arx", "armax", "network", "subspace", "lpv", "bilinear", \
"components"}, optional
        Where the noise enters; or first-order modes that all outputs share (network), or poles,
        real or complex (subspace); or modes whose rate and gains go by the level of an input
        (lpv), along one straight line (bilinear); or few components of many inputs, through lags.
        Default: components for six or more inputs of which half as many components hold 99 % of
        what they vary, where no option of another structure is given; else oe, or subspace for more
        than two responses, and another one where blocks held out speak for it. Of six or more
        inputs those are left out that no output follows, as far as the evidence goes; a structure
        that is named keeps all.
    reduce : {"pca", "pls", "none", "pca:k", "pls:k"}, optional
        Components of the scaled inputs: principal, of partial least squares. Default: all.
    orders : sequence of (nb, nf, nk) or None
        Numerator coefficients, order of the denominator, samples of delay: once for all inputs or
        once for each. None, or nothing: chosen by held-out data.
    modes : int, optional
        Shared modes of a network, or poles of a subspace model. Default: chosen by held-out data.
    delay : float [s] or "auto", optional
        Dead time of a network; "auto" finds it for each input and output. Default: 0.
    noise_orders : (int, int), optional
        Orders of the noise of armax (C) and bj (C, D). Default: 1, 1.
    continuous : bool
        In continuous time (oe).
    real_poles : bool, optional
        Overdamped models only: real, stable poles. Default: where orders of oe are chosen and
        heats, temperatures or speeds drive temperatures or displacements, for heat never swings;
        there blocks held out may speak for pairs.
    initial : {"auto", "rest", "free"}
        State at the first row: settled, free (estimated), or rest unless free is clearly better.
    split : float, optional
        Fit on this first share of the rows, validate on the rest.
    validate : as `data`, optional
        Another log to validate on.
    reference : "first" or float, optional
        What counts as no input in the model. Default: "first" for an absolute temperature, else 0.
    start, stop : float, optional [s]
        The stretch that is fitted and judged; all rows drive what is simulated.
    budget : float, optional [s]
        Time for the choice of orders and modes; then the best of those that were tried is fitted.
        Ctrl-C ends the choice, too.
    warn, progress : callable
        Take a sentence where a log pauses, its clock is uneven or the choice was ended, and a word
        now and then.
    **reading
        See `read_log`.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        Arguments that contradict each other.
    LogError
        A log that cannot be read, lacks a channel, is sampled otherwise than the first, or has
        fewer than two rows.
    FitError
        No fit on these data.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time = np.arange(0.0, 3000.0, 10.0)
    >>> heat = np.where((time // 500) % 2, 100.0, 0.0)
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": heat, "d_z_um": 0.0})
    >>> for k in range(1, 300):
    ...     frame.loc[k, "d_z_um"] = 0.95 * frame["d_z_um"][k - 1] + 0.01 * heat[k - 1]
    >>> found = tt.identify(frame, ["Q_motor_W"], ["d_z_um"], orders=[(1, 1, 1)])
    >>> round(found.model.terms[0].response.dc_gain(), 3)
    0.2
    """
    from thermaltool.fitting.excitation import constant_channels
    from thermaltool.fitting.identification import identify_first
    from thermaltool.fitting.search_budget import SearchBudget
    from thermaltool.report.text import jump_messages, repeated_messages

    inputs, outputs = names(inputs), names(outputs)
    check_arguments(inputs, outputs, structure=structure, reduce=reduce, orders=orders, modes=modes,
                    delay=delay, noise_orders=noise_orders, continuous=continuous, split=split,
                    real_poles=real_poles, initial=initial, validate=validate)  # fmt: skip
    plain = not (orders or noise_orders or continuous or real_poles)
    usual = structure is None and plain
    as_read: list[Log] = []
    logs: list[Log] = []
    parts: list[Log] = []
    over = f"the fit is parted there; in simulate {drives_over_pauses(map(hold_of, inputs))}"
    for each in [*all_of(data), *([] if validate is None else [validate])]:
        log = read_for_fit(each, inputs, "transfer function", (start, stop), outputs=outputs,
                           whole=True, pauses=over, warn=warn,
                           **reading)  # fmt: skip
        as_read.append(log)
        for message in jump_messages(log.between(start, stop), outputs, inputs):
            warn(message)
        if structure != NETWORK:
            log = without_bursts(log, warn)
        part = log.between(start, stop)
        if structure != NETWORK:
            check_clock(part, (parts or [part])[0].period, warn)
        logs.append(log)
        parts.append(part)
    fresh = [] if validate is None else [logs.pop()]
    own = parts[: len(logs)]
    for message in repeated_messages(own):
        warn(message)
    if constant := constant_channels(own, outputs, split, 0.0):
        outputs = tuple(name for name in outputs if name not in constant)
        where = "" if split is None else " over the training rows"
        warn("; ".join(f"{name} is constant{where}: it is left out" for name in constant))
    named = inputs
    still: tuple[LeftOut, ...] = ()
    if structure != COMPONENTS and reduce is None:
        inputs, orders, still = _moving(own, inputs, orders, split)
    left_out: tuple[LeftOut, ...] = ()
    if structure is None:
        if plain and reduce is None:
            inputs, left_out = _screened(own, inputs, outputs, split)
        many = plain and reduce is None and _say_the_same(own, inputs, outputs, split, warn)
        structure = COMPONENTS if many or reduce is not None else USUAL
    search = SearchBudget(math.inf if budget is None else budget, progress)
    plans = plans_of(
        parts, inputs, outputs, structure=structure, usual=usual, reduce=reduce, modes=modes,
        delay=delay, orders=orders, noise_orders=noise_orders, continuous=continuous,
        real_poles=real_poles, reference=reference, rough=bool(left_out),
        initial=initial, split=split, span=(start, stop), budget=search,
    )  # fmt: skip
    fits = identify_first(logs, inputs, outputs, plans, fresh, reference, as_read, warn)
    progress("done\n")
    for part in parts:
        warn_holes(part, inputs, outputs, structure_name(fits[0].model), warn)
    if search.ended:
        warn(
            f"the choice was ended: the best of {search.tried} candidates; other orders and "
            "structures, nonlinear ones among them, may do better"
        )
    unused = sorted((*still, *left_out), key=lambda each: named.index(each.name))
    return Identification(fits, tuple(logs), reference, options_of(reading), tuple(unused))


def _moving(
    logs: Sequence[Record],
    inputs: tuple[str, ...],
    orders: Sequence[Orders | None],
    split: float | None,
) -> tuple[tuple[str, ...], Sequence[Orders | None], tuple[LeftOut, ...]]:
    """Inputs that move over the training rows, with their orders; and the others."""
    from thermaltool.fitting.excitation import MIN_MOVEMENT, constant_channels
    from thermaltool.fitting.screening import LeftOut

    still = constant_channels(logs, inputs, split, MIN_MOVEMENT)
    kept = [k for k, name in enumerate(inputs) if name not in still]
    if len(orders) == len(inputs):
        orders = [orders[k] for k in kept]
    return tuple(inputs[k] for k in kept), orders, tuple(map(LeftOut, still))


def _screened(
    logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str], split: float | None
) -> tuple[tuple[str, ...], tuple[LeftOut, ...]]:
    """Of many inputs those that some output follows over the training rows, and the others."""
    from thermaltool.fitting.components.reduction import MANY_INPUTS
    from thermaltool.fitting.data import even_training_data
    from thermaltool.fitting.screening import screen_all

    if len(inputs) < MANY_INPUTS:
        return tuple(inputs), ()
    sets = [even_training_data(logs, inputs, (output,)) for output in outputs]
    return screen_all([each if split is None else each.split(split).fitted for each in sets])


def _say_the_same(
    logs: Sequence[Log],
    inputs: Sequence[str],
    outputs: Sequence[str],
    split: float | None,
    warn: Notice,
) -> bool:
    """Whether the inputs are many and say much the same over the training rows; says so."""
    from thermaltool.fitting.components.reduction import MANY_INPUTS, carrying, is_reducible
    from thermaltool.fitting.data import even_training_data

    if len(inputs) < MANY_INPUTS:
        return False
    data = even_training_data(logs, inputs, outputs[:1])
    data = data if split is None else data.split(split).fitted
    if not is_reducible(data):
        return False
    warn(
        f"{len(inputs)} inputs of which {carrying(data)} components hold 99 %: --structure "
        "components; --structure oe gives each a transfer function of its own"
    )
    return True
