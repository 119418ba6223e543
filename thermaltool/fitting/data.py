"""Training data: what an estimator is fitted to, as records that it can run through."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, repeat
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.errors import DataError
from thermaltool.fitting.even_clock import Missing, even_records
from thermaltool.fitting.excitation import check_excitation
from thermaltool.record import Record
from thermaltool.units import Hold, hold_of

Array = NDArray[np.float64]

# Which zero an output has in a free run: that of its experiment in the fit; the mean of all of
# them, as a model document has it; or one that is estimated from the run.
Zero = Literal["fitted", "mean", "free"]

# An excerpt excites enough with this share of the power that the best one has.
MIN_EXCITATION = 0.1


@dataclass(frozen=True)
class TrainingData:
    """Records without pauses, whose inputs have no holes.

    Attributes
    ----------
    records : tuple of Record
        `origin` numbers the experiments from 0: one offset each. Outputs are NaN where a reading
        is missing.
    inputs, outputs : tuple of str
        Channels that drive, and that follow.
    period : float [s]
        Usual sample period.
    holds : tuple of "zero" or "first"
        Of each input between its samples; held where none is given.
    logs : tuple of int
        Which of the logs each experiment is: one without a piece is none.
    lagging : tuple of str
        Inputs that reach no output of the same row but by what they do before it.
    """

    records: tuple[Record, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float
    holds: tuple[Hold, ...] = ()
    logs: tuple[int, ...] = ()
    lagging: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.holds:
            object.__setattr__(self, "holds", tuple(repeat("zero", len(self.inputs))))

    @cached_property
    def u(self) -> tuple[Array, ...]:
        """Inputs of each record, shape (m, n)."""
        return tuple(record.matrix(self.inputs) for record in self.records)

    @cached_property
    def y(self) -> tuple[Array, ...]:
        """Outputs of each record, shape (p, n)."""
        return tuple(record.matrix(self.outputs) for record in self.records)

    @property
    def rows(self) -> int:
        """Samples of all records."""
        return sum(map(len, self.records))

    @property
    def longest(self) -> int:
        """Samples of the longest record."""
        return max(map(len, self.records))

    @property
    def duration(self) -> float:
        """Duration of the longest record [s]."""
        return max(record.duration for record in self.records)

    @property
    def experiments(self) -> int:
        """Number of experiments."""
        return 1 + max(record.origin for record in self.records)

    @property
    def least_delays(self) -> tuple[int, ...]:
        """Samples before which each input cannot act: one where it is held between samples."""
        return tuple(int(hold == "zero") for hold in self.holds)

    @property
    def may_act_at_once(self) -> bool:
        """Whether any input may reach an output of the same row directly."""
        return not set(self.inputs) <= set(self.lagging)

    @cached_property
    def levels(self) -> Array:
        """First inputs of each experiment, shape (experiments, m)."""
        found: dict[int, Array] = {}
        for record, u in zip(self.records, self.u, strict=True):
            found.setdefault(record.origin, u[:, 0])
        return np.array([found[k] for k in range(1 + max(found))])

    @property
    def begins(self) -> dict[int, int]:
        """Which record each experiment begins with."""
        return {r.origin: k for k, r in reversed(list(enumerate(self.records)))}

    def output(self, k: int = 0) -> Array:
        """All samples of output k in a row."""
        return np.concatenate([y[k] for y in self.y])

    def about_means(self, measured: Array, computed: Array) -> tuple[Array, Array]:
        """One output as measured and computed, each experiment about the mean of its readings.

        Arbitrary zeros of the logs would else pass for something that a model explains.

        Parameters
        ----------
        measured, computed : ndarray, shape (rows,)
        """
        origins = np.concatenate([np.full(len(r), r.origin) for r in self.records])
        means = np.zeros(self.rows)
        for k in range(self.experiments):
            own = (origins == k) & np.isfinite(measured)
            means[origins == k] = np.mean(measured[own]) if own.any() else 0.0
        return measured - means, computed - means

    def only(self, k: int) -> TrainingData:
        """The data with output k alone."""
        return replace(self, outputs=(self.outputs[k],))

    def driven_by(self, names: Sequence[str]) -> TrainingData:
        """The data with these inputs alone.

        Parameters
        ----------
        names : sequence of str
            Some of `inputs`.
        """
        if tuple(names) == self.inputs:
            return self
        holds = dict(zip(self.inputs, self.holds, strict=True))
        return replace(self, inputs=tuple(names), holds=tuple(holds[name] for name in names))

    def along_lines(self, names: Sequence[str], lagging: Sequence[str] = ()) -> TrainingData:
        """The data with these inputs running straight from row to row.

        Parameters
        ----------
        names, lagging : sequence of str
        """
        holds = zip(self.inputs, self.holds, strict=True)
        lines: tuple[Hold, ...] = tuple("first" if n in names else hold for n, hold in holds)
        return replace(self, holds=lines, lagging=tuple(lagging))

    def measured(self, k: int) -> TrainingData:
        """Output k alone, on the rows where it was measured.

        Raises
        ------
        DataError
            There is none.
        """
        there = [np.isfinite(y[k]) for y in self.y]
        parts = [replace(r.where(rows), at_rest=r.at_rest)
                 for r, rows in zip(self.records, there, strict=True) if rows.any()]  # fmt: skip
        if not parts:
            output = self.outputs[k]
            raise DataError(f"{output} has no reading in any log", output)
        return replace(self.only(k), records=tuple(parts))

    def from_rest(self, experiments: Container[int] | None = None) -> TrainingData:
        """The same, these experiments (None: all) settled at their first inputs when they begin."""
        begins = self.begins
        return replace(self, records=tuple(
            replace(r, at_rest=begins[r.origin] == k
                    and (experiments is None or r.origin in experiments))
            for k, r in enumerate(self.records)
        ))  # fmt: skip

    def split(self, share: float) -> Split:
        """The first `share` of the rows of each experiment to be fitted, and the rest held out.

        Raises
        ------
        DataError
            Nothing on one side.
        """
        rows = Counter[int]()
        for record in self.records:
            rows[record.origin] += len(record)
        wanted = {origin: round(share * count) for origin, count in rows.items()}
        if any(not 0 < n < rows[origin] for origin, n in wanted.items()):
            raise DataError("the split leaves nothing on one side")
        starts = []
        for record in self.records:
            starts.append(min(max(wanted[record.origin], 0), len(record)))
            wanted[record.origin] -= starts[-1]
        return Split(self, tuple(starts), tuple(map(len, self.records)))

    def folds(self, blocks: int) -> list[Split]:
        """Each of so many blocks of every experiment but the first held out in turn.

        The first has no rows before it that say in which state it begins.

        Raises
        ------
        DataError
            Fewer rows than blocks.
        """
        borders = [self.split(k / blocks).starts for k in range(1, blocks)]
        borders.append(tuple(map(len, self.records)))
        return [Split(self, *pair) for pair in pairwise(borders)]

    def excerpt(self, max_rows: int) -> TrainingData:
        """At most so many samples of the longest record, from where the inputs first excite.

        From its beginning where the inputs move in the first half of that about as much as in the
        best such part.
        """
        k = max(range(len(self.records)), key=lambda k: len(self.records[k]))
        whole, half = self.u[k], max_rows // 2
        starts = range(0, max(whole.shape[1] - max_rows, 0) + half, half)
        parts = [whole[:, a : a + half] for a in starts]
        power = np.array([[np.sum((u - u.mean()) ** 2) for u in part] for part in parts])
        least = np.min(power / np.maximum(power.max(axis=0), 1e-300), axis=1)
        start = starts[int(np.argmax(least >= MIN_EXCITATION * least.max()))]
        part = self.records[k].rows(slice(start, start + max_rows))
        return replace(self, records=(replace(part, origin=0),))

    def longest_records(self, count: int) -> TrainingData:
        """The longest records alone, their experiments numbered anew."""
        if len(self.records) <= count:
            return self
        kept = sorted(np.argsort([-len(r) for r in self.records], kind="stable")[:count].tolist())
        origins = {self.records[k].origin: 0 for k in kept}
        numbers = {origin: k for k, origin in enumerate(origins)}
        return replace(self, records=tuple(
            replace(self.records[k], origin=numbers[self.records[k].origin]) for k in kept
        ))  # fmt: skip

    def about_levels(self, rows: int) -> TrainingData:
        """With inputs relative to the first of each experiment, and their past where it is known.

        What begins at rest gets `rows` of input zero in front, so that no row is lost to lags.
        """
        parts = []
        for r, u, y in zip(self.records, self.u, self.y, strict=True):
            n = rows if r.at_rest else 0
            u = np.hstack([np.zeros((len(u), n)), u - self.levels[r.origin][:, None]])
            y = np.hstack([np.zeros((len(y), n)), y])
            time = np.concatenate([r.time[0] + self.period * np.arange(-n, 0), r.time])
            columns = dict(zip((*self.inputs, *self.outputs), (*u, *y), strict=True))
            parts.append(replace(r, time=time, columns=columns, segments=()))
        return replace(self, records=tuple(parts))

    def check(self) -> None:
        """Refuse what says nothing of a transfer function.

        Raises
        ------
        DataError
            An input that never moves, an output that never moves or is never measured, inputs that
            are combinations of each other (named).
        """
        for k in range(len(self.outputs)):
            check_excitation(self.inputs, self.outputs[k], self.u, [y[k] for y in self.y])


@dataclass(frozen=True)
class Split:
    """Data of which a block of each experiment is held out and the rest fitted.

    Attributes
    ----------
    data : TrainingData
        All of it.
    starts, stops : tuple of int
        First row of each record that is held out, and the first behind it.
    """

    data: TrainingData
    starts: tuple[int, ...]
    stops: tuple[int, ...]

    @property
    def parts(self) -> Iterator[tuple[Record, int, int]]:
        """Every record, and which of its rows are held out."""
        return zip(self.data.records, self.starts, self.stops, strict=True)

    @cached_property
    def fitted(self) -> TrainingData:
        """What is fitted."""
        rows = [(r, each) for r, a, b in self.parts for each in (slice(0, a), slice(b, len(r)))]
        return replace(
            self.data, records=tuple(r.rows(each) for r, each in rows if each.stop > each.start)
        )

    @cached_property
    def held(self) -> TrainingData:
        """What is held out."""
        return replace(
            self.data, records=tuple(r.rows(slice(a, b)) for r, a, b in self.parts if b > a)
        )

    def with_start(self, fitted: TrainingData) -> Split:
        """The same with what is known of the start of what is fitted."""
        at_rest = iter([record.at_rest for record in fitted.records])
        records = tuple(
            replace(record, at_rest=next(at_rest)) if n else record
            for record, n in zip(self.data.records, self.starts, strict=True)
        )
        return replace(self, data=replace(self.data, records=records))

    def only(self, k: int) -> Split:
        """The same of output k alone."""
        return replace(self, data=self.data.only(k))


def even_training_data(
    logs: Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    missing: Missing = "reading",
) -> TrainingData:
    """Outputs of several logs, each an experiment, on the even clock of the first.

    Parameters
    ----------
    logs : sequence of Record
    inputs, outputs : sequence of str
    missing : {"reading", "row", "end"}
        What a missing output means, as for `even_records`.

    Raises
    ------
    DataError
        No row has them all.
    """
    period = logs[0].period
    records, used = _numbered(even_records(log, inputs, outputs, period, missing) for log in logs)
    if not records:
        columns = {n: np.hstack([log.column(n) for log in logs]) for n in (*inputs, *outputs)}
        if silent := [n for n, values in columns.items() if not np.isfinite(values).any()]:
            # Rows without all inputs may have been left out before.
            where = "" if set(silent) & set(inputs) else " in the rows that have all inputs"
            raise DataError(f"{', '.join(silent)}: no reading at all{where}")
        named = ", ".join(columns)
        raise DataError(f"{named}: no row has a reading of all inputs and of an output")
    holds = tuple(map(hold_of, inputs))
    return TrainingData(records, tuple(inputs), tuple(outputs), period, holds, used)


def training_data(
    logs: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
) -> TrainingData:
    """Several outputs of several logs, each an experiment, on their own clocks.

    Parameters
    ----------
    logs : sequence of Record
    inputs, outputs : sequence of str

    Raises
    ------
    DataError
        An input is never there.
    """
    records, used = _numbered(log.pieces(inputs) for log in logs)
    if not records:
        raise DataError(f"{', '.join(inputs)}: no two rows in a row have a reading")
    holds = tuple(map(hold_of, inputs))
    return TrainingData(records, tuple(inputs), tuple(outputs), logs[0].period, holds, used)


def _numbered(logs: Iterable[Iterable[Record]]) -> tuple[tuple[Record, ...], tuple[int, ...]]:
    """All pieces of each log, which is an experiment, and which of the logs these are.

    Experiments count from 0 without a hole: a log without a piece is none.
    """
    found = [(index, pieces) for index, each in enumerate(logs) if (pieces := list(each))]
    records = tuple(
        replace(piece, origin=k) for k, (_, pieces) in enumerate(found) for piece in pieces
    )
    return records, tuple(index for index, _ in found)
