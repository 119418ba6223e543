"""What tells of a joint: a bend with the heat, contact temperatures beyond the linear model.

Everything is taken beyond what is linear in the drives: a linear response to the drives, fitted to
the reference logs, is taken from readings and candidates alike, so that what is left is zero there
and says in the other logs what does not go in proportion. Gains follow by least squares, lags from
a list of trials; what is taken has evidence, and predicts logs (or rows) held out no worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.dynamics import from_rest, lagged, time_constants
from thermaltool.effects.joint_contact import JointContact
from thermaltool.fitting.projection import linear_least_squares
from thermaltool.fitting.response_search import independent_rows
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive, relative
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.responses.relaxation import RelaxationGrid
from thermaltool.signals.resolution import reading_sigma

# Rates a decade of the linear response, from a third of the slowest that a record shows to a third
# of a sample.
RATES_PER_DECADE, BEYOND = 4, 3.0
# Directions of the linear response, and of the gains, below this share of the largest are noise.
MIN_DIRECTION = 1e-4
# Lags that are tried, from ten samples to a third of the longest record.
LAG_SAMPLES, LAG_TRIALS = 10.0, 8
# Each log is cut into so many blocks, every fourth of which is held out in turn.
BLOCKS, FOLDS = 16, 4
# A kelvin that a joint makes at a contact bends the machine by no more than this share of what one
# of its whole warming does. The pair of source and sink at a joint is part of the heat that warms
# the machine, and bends by as much a kelvin where all of it takes that way; more is a temperature
# that hardly departs, and would run away above the levels of the logs.
MAX_BEND = 1.0
# A displacement that goes less far than so many times the noise of a reading shows no joint: noise
# alone reaches 8 in ten thousand rows.
MIN_REACH = 8.0
# Least noise of a reading where logs have none [share of the departure].
FLOOR = 1e-9

# A source of departure: "" for the bend with the heat, else a contact temperature.
Source = str


@dataclass(frozen=True)
class JointPart:
    """A source at once, through a lag, or both.

    Attributes
    ----------
    source : str
        Empty for the bend with the heat; else the channel of a contact temperature.
    now : bool
        Whether it acts at once.
    lag : float [s]
        Time constant through which it acts, too; 0 for none.
    outputs : tuple of int
        Displacements that it bends, among those that move.
    """

    source: Source
    now: bool
    lag: float
    outputs: tuple[int, ...]

    @property
    def columns(self) -> tuple[tuple[Source, float], ...]:
        """(source, lag) of every signal that it takes."""
        late = ((self.source, self.lag),) if self.lag else ()
        return (*(((self.source, 0.0),) if self.now else ()), *late)

    @property
    def parameters(self) -> int:
        """Fitted ones beside the gains."""
        return int(self.lag > 0)


@dataclass(frozen=True)
class _Fitted:
    """Parts fitted to every displacement: gains (columns, outputs), what is left of each."""

    parts: tuple[JointPart, ...]
    gains: Float
    left: Float
    rows: Float

    def criterion(self, rows: Float) -> float:
        """The Bayesian information criterion of so many independent rows of each output."""
        count = sum(len(p.outputs) * len(p.columns) + p.parameters for p in self.parts)
        return float(rows @ np.log(self.left)) + count * float(np.log(np.sum(rows)))


@dataclass
class JointSearch:
    """The departures of displacements, and what may tell of them.

    Attributes
    ----------
    records : sequence of Record
    drives : sequence of Drive
    displacements : sequence of str
    linear : sequence of mapping of channel to ndarray, one for each record
        What the linear model has of the temperatures, relative to rest.
    near : str or None
        The temperature near the source by which displacements may bend.
    contacts : sequence of str
    reference : sequence of bool
        Which records the linear response is fitted to.
    beyond : tuple of str
        After a search: contacts that tell of the departures by bending more than `MAX_BEND` alone.
    """

    records: Sequence[Record]
    drives: Sequence[Drive]
    displacements: Sequence[str]
    linear: Sequence[Mapping[str, Float]]
    near: str | None
    contacts: Sequence[str]
    reference: Sequence[bool]
    beyond: tuple[str, ...] = field(default=(), init=False)
    _signals: dict[tuple[Source, float], Float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        lengths = [len(record) for record in self.records]
        self._owner = np.repeat(np.arange(len(lengths)), lengths)
        self._bank = np.vstack([self._driven(record) for record in self.records])
        self._offsets = np.eye(len(lengths))[self._owner]
        self._moved = [o for o in self.displacements if self._moves(o)]
        if not self._moved:
            return
        measured = np.column_stack(
            [np.concatenate([r.column(o) for r in self.records]) for o in self._moved]
        )
        self._there = np.isfinite(measured)
        self._departure = np.column_stack(
            [self._beyond(y, there) for y, there in zip(measured.T, self._there.T, strict=True)]
        )
        whole = np.where(self._there, measured, np.nan)
        self._reach = np.nanmax(whole, axis=0) - np.nanmin(whole, axis=0)
        self._floor = FLOOR * np.max(np.abs(self._departure), axis=0)
        self._noise = np.maximum([self._sigma(o) for o in self._moved], self._floor)

    @property
    def level(self) -> float:
        """Largest value of the temperature by which displacements bend [its unit]."""
        by = self.contacts[0] if self.near is None else self.near
        return max(float(np.max(np.abs(each[by]))) for each in self.linear)

    def effects(self) -> tuple[JointContact, ...]:
        """Sources that are taken, one after another; none where none has evidence."""
        if not self._moved:
            return ()
        best, sources = self._fit(()), [*([] if self.near is None else [""]), *self.contacts]
        while sources:
            tried = [self._fit((*best.parts, part)) for s in sources for part in self._parts(s)]
            found = [own for each in tried if (own := self._within_bound(each)) is not None]
            if not best.parts:
                self.beyond = self._beyond_bound(tried, best)
            if not found:
                break
            rows = min(found, key=lambda each: float(np.sum(np.log(each.left)))).rows
            other = min(found, key=lambda each: each.criterion(rows))
            source = other.parts[-1].source
            decided = other.criterion(rows) < best.criterion(rows) - DECISIVE
            if not decided:
                break
            if self._held_out(other.parts) < self._held_out(best.parts):
                best = other
            sources.remove(source)
        return self._as_effects(best)

    def _parts(self, source: Source) -> Iterator[JointPart]:
        period = min(record.period for record in self.records)
        duration = max(record.duration for record in self.records)
        lags = time_constants(LAG_SAMPLES * period, duration, LAG_TRIALS)
        every = tuple(range(len(self._moved)))
        yield JointPart(source, True, 0.0, every)
        for now, lag in product((False, True), lags):
            yield JointPart(source, now, lag, every)

    def _driven(self, record: Record) -> Float:
        """What the drives make of a grid of rates, shape (n, drives · rates)."""
        duration = max(each.duration for each in self.records)
        period = min(each.period for each in self.records)
        grid = RelaxationGrid.between(
            1 / (BEYOND * duration), 1 / (BEYOND * period), per_decade=RATES_PER_DECADE
        )
        states = []
        for drive in self.drives:
            u = relative(record.column(drive.channel), drive.reference, drive.hold)
            states.append(grid.states(record.time, u, drive.hold))
        return np.hstack(states)

    def _beyond(self, values: Float, there: NDArray[np.bool_]) -> Float:
        """Values minus a linear response of the drives that is fitted to the reference logs."""
        rows = there & np.asarray(self.reference)[self._owner]
        columns = np.hstack([self._bank, self._offsets])
        kept = linear_least_squares(columns[rows], values[rows], MIN_DIRECTION)
        return np.where(there, values - columns @ kept, 0.0)

    def _signal(self, source: Source, lag: float) -> Float:
        """A source through a lag, beyond what is linear in the drives."""
        if (source, lag) not in self._signals:
            own = [self._source(k, source) for k in range(len(self.records))]
            if lag:
                own = [
                    lagged(record.time, x, lag, "first")
                    for record, x in zip(self.records, own, strict=True)
                ]
            x = np.concatenate(own)
            self._signals[source, lag] = self._beyond(x, np.full(len(x), True))
        return self._signals[source, lag]

    def _source(self, k: int, source: Source) -> Float:
        if source:
            return from_rest(self.records[k], source) - self.linear[k][source]
        assert self.near is not None
        share = self.linear[k][self.near] / self.level
        return np.asarray(share * np.abs(share))

    def _columns(self, parts: Sequence[JointPart]) -> Float:
        signals = [self._signal(*column) for part in parts for column in part.columns]
        return np.column_stack([*signals, self._offsets])

    def _of(self, k: int, parts: Sequence[JointPart]) -> NDArray[np.bool_]:
        """Which of the columns one displacement has."""
        bends = [k in part.outputs for part in parts for _ in part.columns]
        return np.array([*bends, *[True] * len(self.records)])

    def _fit(self, parts: tuple[JointPart, ...]) -> _Fitted:
        every = self._columns(parts)
        gains, left, rows = [], [], []
        for k, there in enumerate(self._there.T):
            kept = self._of(k, parts)
            columns = every[np.ix_(there, kept)]
            own = np.zeros(len(kept))
            own[kept] = linear_least_squares(columns, self._departure[there, k], MIN_DIRECTION)
            residual = self._departure[there, k] - columns @ own[kept]
            gains.append(own[: -len(self.records)])
            left.append(float(residual @ residual) + len(residual) * self._floor[k] ** 2)
            rows.append(independent_rows(residual))
        return _Fitted(parts, np.array(gains).T, np.array(left), np.array(rows))

    def _sigma(self, displacement: str) -> float:
        """Noise of a reading."""
        return max(reading_sigma(r.column(displacement)) for r in self.records)

    def _moves(self, displacement: str) -> bool:
        """Whether a displacement goes further than its noise."""
        values = np.concatenate([r.column(displacement) for r in self.records])
        return float(np.nanmax(values) - np.nanmin(values)) > MIN_REACH * self._sigma(displacement)

    def _beyond_bound(self, tried: Sequence[_Fitted], none: _Fitted) -> tuple[str, ...]:
        """Contacts with evidence, whose gains are above the bound."""
        above = [each for each in tried if self._too_far(each)]
        least = {
            each.parts[-1].source
            for each in above
            if each.criterion(each.rows) < none.criterion(each.rows) - DECISIVE
        }
        return tuple(c for c in self.contacts if c in least)

    def _too_far(self, fitted: _Fitted) -> set[int]:
        """Displacements that a kelvin at a contact bends by more than one of its whole warming.

        See `MAX_BEND`.
        """
        sources = [source for part in fitted.parts for source, _ in part.columns]
        found: set[int] = set()
        for contact in filter(None, set(sources)):
            own = [k for k, source in enumerate(sources) if source == contact]
            warming = max(float(np.max(np.abs(each[contact]))) for each in self.linear)
            total = np.sum(np.abs(fitted.gains[own]), axis=0)
            found |= set(np.flatnonzero(total > MAX_BEND * self._reach / warming).tolist())
        return found

    def _within_bound(self, fitted: _Fitted) -> _Fitted | None:
        """The same without its last part in displacements that it bends too far; None if in all.

        One that departs for a reason of its own takes no contact from the others.
        """
        last, over = fitted.parts[-1], self._too_far(fitted)
        kept = tuple(k for k in last.outputs if k not in over)
        if not kept:
            return None
        if kept == last.outputs:
            return fitted
        return self._fit((*fitted.parts[:-1], replace(last, outputs=kept)))

    def _folds(self) -> list[NDArray[np.bool_]]:
        """Blocks of time that are held out in turn."""
        place = np.concatenate([np.arange(len(r)) * BLOCKS // len(r) for r in self.records])
        return [place % FOLDS == k for k in range(FOLDS)]

    def _held_out(self, parts: tuple[JointPart, ...]) -> float:
        """Squared errors on rows that the gains have not seen, in units of the noise."""
        every, total = self._columns(parts), 0.0
        for out in self._folds():
            for k, there in enumerate(self._there.T):
                seen, unseen = there & ~out, there & out
                columns = every[:, self._of(k, parts)]
                signals = columns[:, : -len(self.records)]
                own = linear_least_squares(columns[seen], self._departure[seen, k], MIN_DIRECTION)
                error = self._departure[unseen, k] - signals[unseen] @ own[: signals.shape[1]]
                # A displacement has no zero of its own.
                logs = np.split(error, np.flatnonzero(np.diff(self._owner[unseen])) + 1)
                total += sum(float(np.sum((e - e.mean()) ** 2)) for e in logs) / self._noise[k] ** 2
        return total

    def _as_effects(self, fitted: _Fitted) -> tuple[JointContact, ...]:
        """One effect for each source."""
        found, at = [], 0
        for part in fitted.parts:
            names = {True: ("contact", "deviation"), False: ("forces", "heat")}[bool(part.source)]
            bent = [(k, self._moved[k]) for k in part.outputs]
            own: dict[str, float] = {}
            for _, lag in part.columns:
                gains = fitted.gains[at]
                base = names[lag > 0]
                own |= {f"{base}[{o}]": float(gains[k]) for k, o in bent}
                at += 1
            late = {"time_constant": part.lag} if part.lag else {}
            near = part.source if self.near is None else self.near
            found.append(
                JointContact(
                    near, {**own, **late, "level": self.level}, partner=part.source or None
                )
            )
        return tuple(found)
