"""Logs and declared networks in, fitted networks out."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, Unpack

from thermaltool.api.inputs import Reading, all_of, read_for_fit, read_toml, reads
from thermaltool.api.result import Notice, Result, notice, silent
from thermaltool.api.simulation import simulate

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.fitting.rc.compare import RcComparison
    from thermaltool.fitting.rc.fit import RcFit
    from thermaltool.fitting.rc.network import RcNetwork
    from thermaltool.fitting.rc.validation import InnovationTests, RcAgreement
    from thermaltool.logs import Log
    from thermaltool.logs.reader import Data
    from thermaltool.model import Model

    Network: TypeAlias = str | os.PathLike[str] | Mapping[str, Any] | RcNetwork


@dataclass(frozen=True, repr=False)
class GreyBox(Result):
    """Fitted networks, and which of them is enough.

    Attributes
    ----------
    comparison : RcComparison
        The fits, and likelihood-ratio tests of nested pairs.
    logs : tuple of Log
        That were fitted.
    tests : mapping of network to mapping of channel to InnovationTests
    agreements : tuple of RcAgreement
    """

    comparison: RcComparison
    logs: tuple[Log, ...]
    tests: Mapping[str, Mapping[str, InnovationTests]]
    agreements: tuple[RcAgreement, ...]

    @property
    def fit(self) -> RcFit:
        """The network that is enough."""
        return self.comparison.sufficient

    @cached_property
    def model(self) -> Model:
        """The model document of the network that is enough."""
        return _model(self.fit, self.logs)

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the networks, each a sentence."""
        from thermaltool.report.rc import rc_warnings

        return tuple(rc_warnings(self.comparison, self.agreements))

    @property
    def frame(self) -> pandas.DataFrame:
        """Parameters with their 95 % intervals, one row each."""
        import pandas

        rows = [
            (fit.network.name, name, e.value, e.low, e.high, e.unit)
            for fit in self.comparison.fits
            for name, e in fit.estimates.items()
        ]
        columns = ["network", "parameter", "value", "low", "high", "unit"]
        return pandas.DataFrame(rows, columns=columns).set_index(columns[:2])

    def document(self) -> dict[str, Any]:
        """Fits, tests and agreements as ``rc --json`` writes them."""
        from thermaltool.report.rc import rc_document

        return rc_document(self.comparison, self.tests, self.agreements)

    def table(self) -> str:
        """Parameters of each network, tests between them, and which is enough."""
        from thermaltool.report.rc import rc_table

        return rc_table(self.comparison, self.tests, self.agreements)

    def draw(self) -> Figure:
        """Measured and simulated readings over the first log, and their difference."""
        from thermaltool.report.residuals import draw_comparison

        return draw_comparison(self.model, self.logs[0])


@reads(Reading)
def rc(
    data: Data | Sequence[Data],
    network: Network | Sequence[Network],
    *,
    initial: Literal["free", "rest"] = "free",
    split: float | None = None,
    validate: Data | None = None,
    start: float | None = None,
    stop: float | None = None,
    warn: Notice = notice,
    **reading: Unpack[Reading],
) -> GreyBox:
    """Networks of heat capacities and conductances from measured logs, by Kalman likelihood.

    Parameters
    ----------
    data : str, path, pandas.DataFrame, Record, or a sequence of them
        Each log begins in a state of its own. Missing readings are left out one by one.
    network : str, path, mapping or RcNetwork, or a sequence of them
        Declarations (TOML files, or what is in one); nested ones are tested against each other.
    initial : {"free", "rest"}
        State at the first row: unknown, or settled without heat, as `simulate` takes it.
    split : float, optional
        Fit on this first share of the rows of each log, validate on the rest.
    validate : as `data`, optional
        Another log to validate on.
    start, stop : float, optional [s]
        The stretch that is fitted.
    warn : callable
        Takes a sentence where a log pauses.
    **reading
        See `read_log`.

    Returns
    -------
    GreyBox

    Raises
    ------
    ValueError
        Both `split` and `validate`.
    LogError
        A log that cannot be read, lacks a channel, or has fewer than two rows.
    ModelError
        A declaration that cannot be read.
    FitError
        No fit on these data, or networks that cannot be compared.

    Examples
    --------
    >>> import numpy as np, pandas as pd, thermaltool as tt
    >>> time, rng = np.arange(0.0, 6000.0, 10.0), np.random.default_rng(1)
    >>> heat = np.where((time // 900) % 2, 100.0, 0.0)
    >>> T = np.full(600, 20.0)
    >>> for k in range(599):
    ...     T[k + 1] = T[k] + 10.0 / 800.0 * (heat[k] - 2.0 * (T[k] - 20.0))
    >>> frame = pd.DataFrame({"time_s": time, "Q_motor_W": heat, "T_room_degC": 20.0})
    >>> frame["T_motor_degC"] = T + 0.05 * rng.standard_normal(600)
    >>> found = tt.rc(frame, {
    ...     "format": "thermaltool-rc", "version": 1, "name": "one",
    ...     "nodes": {"motor": {"measured": "T_motor_degC", "diffusion": 0}},
    ...     "links": {"room": {"between": ["motor", "T_room_degC"]}},
    ...     "heat": {"motor": {"channel": "Q_motor_W", "node": "motor"}},
    ... })
    >>> round(found.fit.estimates["links.room.conductance"].value, 1)
    2.0
    """
    from thermaltool.fitting.rc.compare import compare, is_nested
    from thermaltool.fitting.rc.data import filter_pieces, held_out
    from thermaltool.fitting.rc.fit import fit_network
    from thermaltool.fitting.rc.validation import innovation_tests

    if split is not None and validate is not None:
        raise ValueError("--split and --validate both name the validation data: take one")
    several = network if isinstance(network, list | tuple) else [network]
    networks = sorted(map(as_network, several), key=lambda each: len(each.free))
    need = tuple(dict.fromkeys(name for each in networks for name in each.inputs))

    def read(each: Data) -> Log:
        log = read_for_fit(each, need, "network", (start, stop),
                           pauses="the state there is unknown", warn=warn, **reading)  # fmt: skip
        for name in networks[0].outputs:
            log.column(name)
        return log

    logs = tuple(read(each) for each in all_of(data))
    fits: list[RcFit] = []
    for each in networks:
        rows = None if split is None else held_out(filter_pieces(each, logs), split)
        known = fits[-1].values if fits else {}
        at_most = min((f.deviance for f in fits if is_nested(f.network, each)), default=math.inf)
        fits.append(fit_network(each, logs, from_rest=initial == "rest", known=known, rows=rows,
                                at_most=at_most))  # fmt: skip
    fresh = () if validate is None else (read(validate),)
    agreements = tuple(a for fit in fits for a in _agreements(fit, logs, fresh, split))
    tests = {fit.network.name: innovation_tests(fit) for fit in fits}
    return GreyBox(compare(fits), logs, tests, agreements)


def as_network(network: Network) -> RcNetwork:
    """A network: itself, what is declared, or the declaration in a file (ModelError)."""
    from thermaltool.fitting.rc.declaration import load_network
    from thermaltool.fitting.rc.network import RcNetwork

    if isinstance(network, RcNetwork):
        return network
    if isinstance(network, Mapping):
        return load_network(network, "network", "<network>")
    path = os.fspath(network)
    return load_network(read_toml(path), os.path.splitext(os.path.basename(path))[0], path)


def _model(fit: RcFit, logs: Sequence[Log]) -> Model:
    from thermaltool.fitting.rc.document import rc_model

    return rc_model(fit, logs, {"logs": [log.source for log in logs]})


def _agreements(
    fit: RcFit, logs: Sequence[Log], fresh: Sequence[Log], split: float | None
) -> list[RcAgreement]:
    """Over fitted and held-out rows of each log, by the model document and by the filter."""
    from thermaltool.fitting.rc.data import filter_pieces, held_out
    from thermaltool.fitting.rc.validation import RcAgreement, carried_on, one_step

    found: list[RcAgreement] = []
    name, outputs, model = fit.network.name, fit.network.outputs, _model(fit, logs)
    for number, log in enumerate((*logs, *fresh)):
        kind: Literal["fitted", "held out"] = "fitted" if number < len(logs) else "held out"
        if split is None or kind == "held out":
            steps, whole = one_step(fit, [log]), simulate(model, log, warn=silent).agreements
            found += [RcAgreement(name, log.name, c, kind, whole[c], steps[c]) for c in outputs]
            continue
        pieces = filter_pieces(fit.network, [log])
        rows = held_out(pieces, split)
        last = max(float(p.time[n - 1]) for p, n in zip(pieces, rows, strict=True) if n)
        following = float(log.time[log.time > last][0])
        before = simulate(model, log, stop=last, warn=silent).agreements
        after = simulate(model, log, start=following, warn=silent).agreements
        steps = one_step(fit, [log.between(None, last)])
        free, corrected = carried_on(fit, [log], rows)
        for c in outputs:
            found.append(RcAgreement(name, log.name, c, "fitted", before[c], steps[c]))
            found.append(
                RcAgreement(name, log.name, c, "held out", after[c], corrected[c], free[c])
            )
    return found
