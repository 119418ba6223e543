"""The problem y_o = Σ_ij K_oij u_i(t − L_oi)/(τ_j s + 1) + Σ_i K0_oi u_i(t) + offset + Σ_j a_oj
e^(−t/τ_j) + noise.

For given time constants all else is linear and the same for every output: gains, feedthrough where
it is wanted, one offset for each experiment, the decay of every mode from an unknown state. It is
projected out (variable projection, Golub and Pereyra 1973); one pass over the rows leaves sums from
which the loss of every output and its slopes by the logarithms of the time constants follow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.fitting.data import Array, TrainingData
from thermaltool.fitting.joint import MIN_LOSS, ProjectedOutput
from thermaltool.record import Record
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Hold, Modes
from thermaltool.signals.gauss_newton import solve

Index = NDArray[np.intp]
Delays = tuple[tuple[float, ...], ...]


def mode_responses(
    time: Array, inputs: Array, levels: Array, taus: Array, delays: Sequence[float],
    holds: Sequence[Hold], slopes: bool = False, stride: int = 1,
) -> Array:  # fmt: skip
    """Every mode with a steady state of 1, driven by every input relative to `levels`.

    An input is taken to have stood at its first value before the record; what that is wrong by
    decays like the mode itself.

    Parameters
    ----------
    time : ndarray, shape (n,) [s]
        From the first row on.
    inputs : ndarray, shape (m, n)
    levels : ndarray, shape (m,)
    taus : ndarray, shape (N,) [s]
    delays : sequence of float, one for each input [s]
    holds : sequence of "zero" or "first"
    slopes : bool
        The derivatives by ln τ instead: 1/(τs + 1)² − 1/(τs + 1).
    stride : int
        Every so many rows are kept.

    Returns
    -------
    ndarray, shape (m · N, rows kept)
    """
    rows = []
    for u, level, delay, hold in zip(inputs, levels, delays, holds, strict=True):
        moved, stood = u - u[0], 0.0 if slopes else u[0] - level
        for tau in taus.tolist():
            pole = np.array([-1 / tau], complex)
            weight = np.array([(-1 if slopes else 1) / tau], complex)
            double = np.array([1 / tau**2 if slopes else 0.0])
            modes = (DelayedModes(pole, weight, double, delay) if delay
                     else Modes(pole, weight, double))  # fmt: skip
            rows.append(modes.run(time, moved, hold)[::stride] + stood)
    return np.array(rows)


def known_rows(record: Record, delays: Sequence[float]) -> NDArray[np.bool_]:
    """Rows whose delayed inputs are in the record, or before it known to stand still, shape (n,).

    Parameters
    ----------
    record : Record
    delays : sequence of float, one for each input [s]
    """
    return np.asarray((record.elapsed >= max(delays)) | record.at_rest)


@dataclass(frozen=True)
class Sums:
    """Sums over the rows of one output.

    Attributes
    ----------
    gram : ndarray, shape (S, S)
        Of the columns: gains, feedthrough, offsets, decays, then the slopes of gains and decays.
    cross : ndarray, shape (S,)
        Of the columns with the output.
    power : float
    rows : int
    """

    gram: Array
    cross: Array
    power: float
    rows: int


@dataclass(frozen=True)
class NetworkProblem:
    """Least squares of all outputs for given time constants.

    Attributes
    ----------
    data : TrainingData
    delays : tuple of tuple of float, for each output one for each input [s]
    stride : int
        Every so many rows count; the modes are followed over all.
    direct : bool
        Whether outputs may follow the inputs of the same row.
    """

    data: TrainingData
    delays: Delays
    stride: int = 1
    direct: bool = False

    @property
    def direct_count(self) -> int:
        """Number of feedthroughs of one output."""
        return len(self.data.inputs) * self.direct

    def free(self) -> list[int]:
        """Place of each record among those that begin in an unknown state; −1 at rest."""
        counts = np.cumsum([not r.at_rest for r in self.data.records]) - 1
        return [-1 if r.at_rest else int(k) for r, k in zip(self.data.records, counts, strict=True)]

    def linear_count(self, modes: int) -> int:
        """Number of linear parameters of one output, L: gains, feedthrough, offsets, decays."""
        unknown = sum(not record.at_rest for record in self.data.records)
        own = self.direct_count + self.data.experiments
        return modes * (len(self.data.inputs) + unknown) + own

    def rows(self, k: int) -> int:
        """Number of rows of output k that count."""
        return sum(int(self.used(j)[k].sum()) for j in range(len(self.data.records)))

    def used(self, j: int) -> NDArray[np.bool_]:
        """Which of every `stride` rows of record j count for each output, shape (p, rows)."""
        kept = np.isfinite(self.data.y[j])
        for k, delays in enumerate(self.delays):
            kept[k] &= known_rows(self.data.records[j], delays)
        return kept[:, :: self.stride]

    def centres(self) -> Array:
        """Mean of every output in every experiment, shape (p, experiments)."""
        found = np.zeros((len(self.delays), self.data.experiments))
        for origin in range(self.data.experiments):
            own = [y for r, y in zip(self.data.records, self.data.y, strict=True)
                   if r.origin == origin]  # fmt: skip
            values = np.hstack(own) if own else np.zeros((len(self.delays), 0))
            for k, y in enumerate(values):
                used = np.isfinite(y)
                found[k, origin] = float(np.mean(y[used])) if used.any() else 0.0
        return found

    def columns(self, j: int, taus: Array, delays: Sequence[float], slopes: bool) -> Array:
        """Columns of every `stride` rows of record j, each a row, shape (columns, rows).

        Parameters
        ----------
        j : int
        taus : ndarray, shape (N,) [s]
        delays : sequence of float, one for each input [s]
        slopes : bool
            Behind all linear ones also the slopes of gains and decays by ln τ.
        """
        record, elapsed = self.data.records[j], self.data.records[j].elapsed
        levels, time = self.data.levels[record.origin], elapsed[:: self.stride]
        given = elapsed, self.data.u[j], levels, taus, delays, self.data.holds
        parts = [mode_responses(*given, stride=self.stride)]
        if self.direct:
            parts.append((self.data.u[j] - levels[:, None])[:, :: self.stride])
        parts.append(np.ones((1, len(time))))
        passed = time / taus[:, None] if not record.at_rest else np.zeros((0, len(time)))
        parts.append(np.exp(-passed))
        if slopes:
            parts.append(mode_responses(*given, slopes=True, stride=self.stride))
            parts.append(passed * np.exp(-passed))
        return np.vstack(parts)

    def places(self, modes: int, slopes: bool) -> list[Index]:
        """Places of the columns of each record among those of all records."""
        gains, origins = modes * len(self.data.inputs), self.data.experiments
        kept = gains + self.direct_count
        linear, found = self.linear_count(modes), []
        for record, free in zip(self.data.records, self.free(), strict=True):
            own = np.arange(0 if free < 0 else modes) + modes * max(free, 0)
            offset = np.array([kept + record.origin])
            place = [np.arange(kept), offset, kept + origins + own]
            if slopes:
                place += [linear + np.arange(gains), linear + gains + own]
            found.append(np.concatenate(place).astype(np.intp))
        return found

    def sums(self, taus: Array, slopes: bool = True) -> list[Sums]:
        """Sums over the rows of every output; those with the same delays and rows share one matrix.

        Parameters
        ----------
        taus : ndarray, shape (N,) [s]
        slopes : bool
            Whether the slopes by ln τ are among the columns.
        """
        n, p = len(taus), len(self.delays)
        linear = self.linear_count(n)
        size = 2 * linear - self.direct_count - self.data.experiments if slopes else linear
        grams: dict[tuple[bytes, ...], Array] = {}
        keys: list[list[bytes]] = [[] for _ in range(p)]
        cross, power, rows = np.zeros((p, size)), np.zeros(p), np.zeros(p, int)
        centres, parts = self.centres(), []
        for j, place in enumerate(self.places(n, slopes)):
            used, columns = self.used(j), {}
            products: dict[bytes, Array] = {}
            for k, delays in enumerate(self.delays):
                if delays not in columns:
                    columns[delays] = self.columns(j, taus, delays, slopes)
                key = repr(delays).encode() + np.packbits(used[k]).tobytes()
                kept = columns[delays] if used[k].all() else columns[delays][:, used[k]]
                if key not in products:
                    products[key] = kept @ kept.T
                y = self.data.y[j][k, :: self.stride][used[k]]
                y = y - centres[k, self.data.records[j].origin]
                cross[k, place] += kept @ y
                power[k] += float(y @ y)
                rows[k] += len(y)
                keys[k].append(key)
            parts.append((place, products))
        for each in map(tuple, keys):
            if each not in grams:
                whole = np.zeros((size, size))
                for own, (place, products) in zip(each, parts, strict=True):
                    whole[np.ix_(place, place)] += products[own]
                grams[each] = whole
        return [Sums(grams[tuple(keys[k])], cross[k], float(power[k]), int(rows[k]))
                for k in range(p)]  # fmt: skip

    def mean_square(self, taus: Array) -> list[float]:
        """Mean square error of every output for time constants `taus`, shape (N,) [s]."""
        sums = self.sums(taus, slopes=False)
        losses = [s.power - float(s.cross @ solve(s.gram, s.cross)) for s in sums]
        return [loss / max(s.rows, 1) for loss, s in zip(losses, sums, strict=True)]

    def project(self, taus: Array) -> list[ProjectedOutput]:
        """Every output for given time constants, its linear parameters projected out.

        Parameters
        ----------
        taus : ndarray, shape (N,) [s]
        """
        n = len(taus)
        linear, gains = self.linear_count(n), n * len(self.data.inputs)
        inner, outer = slice(0, linear), slice(linear, None)
        found = []
        for s in self.sums(taus):
            G, g = s.gram[inner, inner], s.cross[inner]
            # A slope by ln τ_j: those of its gains and decays, by their sizes.
            c = solve(G, g)
            decays = gains + self.direct_count + self.data.experiments
            sizes = np.concatenate([c[:gains], c[decays:]])
            turn = np.zeros((len(sizes), n))
            turn[np.arange(len(sizes)), np.arange(len(sizes)) % n] = sizes
            across = s.gram[inner, outer] @ turn
            by_taus = solve(G, across)
            reduced = turn.T @ s.gram[outer, outer] @ turn - across.T @ by_taus
            pull = turn.T @ s.cross[outer] - across.T @ c
            loss = max(s.power - float(g @ c), MIN_LOSS * s.power, 1e-300)
            found.append(ProjectedOutput(c, loss, s.rows, by_taus, G, reduced, pull))
        return found

    def sensitivities(
        self, j: int, k: int, taus: Array, found: ProjectedOutput
    ) -> tuple[Array, Array]:
        """How the rows of record j of output k follow ln τ and the linear parameters.

        Parameters
        ----------
        j, k : int
        taus : ndarray, shape (N,) [s]
        found : ProjectedOutput
            Output k at these time constants.

        Returns
        -------
        slopes : ndarray, shape (N, rows)
            What the linear columns leave of the slopes by ln τ; zero where no row counts.
        linear : ndarray, shape (l, rows)
            The linear columns of the record (`places`); zero where no row counts.
        """
        n, place = len(taus), self.places(len(taus), False)[j]
        rows = self.columns(j, taus, self.delays[k], slopes=True) * self.used(j)[k]
        linear, slopes = rows[: len(place)], rows[len(place) :]
        gains = n * len(self.data.inputs)
        sizes = np.delete(found.linear[place], range(gains, gains + self.direct_count + 1))
        whole = np.array([sizes[i::n] @ slopes[i::n] for i in range(n)])
        return whole - found.by_searched[place].T @ linear, linear

    def errors(
        self, taus: Array, found: Sequence[ProjectedOutput]
    ) -> Iterator[tuple[int, int, Array]]:
        """For each output and record: (output, record, its errors, NaN where no row counts).

        Parameters
        ----------
        taus : ndarray, shape (N,) [s]
        found : sequence of ProjectedOutput
        """
        centres = self.centres()
        for j, (record, place) in enumerate(
            zip(self.data.records, self.places(len(taus), False), strict=True)
        ):
            used, seen = self.used(j), dict.fromkeys(self.delays)
            columns = {delays: self.columns(j, taus, delays, slopes=False) for delays in seen}
            for k, delays in enumerate(self.delays):
                computed = found[k].linear[place] @ columns[delays]
                y = self.data.y[j][k, :: self.stride]
                error = y - centres[k, record.origin] - computed
                yield k, j, np.where(used[k], error, np.nan)
