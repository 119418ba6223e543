"""Kinds of response by the logarithms of their rates and shapes: what a calibration searches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermaltool.responses import Response
from thermaltool.responses.modes import Float
from thermaltool.responses.relaxation import RelaxationGrid

# Lags over the longest record: the largest that is searched, with a free start, and what the kinds
# admit (`search_box`). Of conduction, whose slowest one comes from two parameters, the diffusivity
# is held in its place.
SLOWEST, SLOWEST_FREE, SLOWEST_KNOWN = 5.0, 1.0, 50.0
# Starts whose weights are kept, each of a drive: some 10 MB.
KEPT_STARTS = 4096
# Over which slopes are taken, in logarithms. The weights on the grid are exact to some nine digits:
# differences over less are rounding, and a search ends where that of the machine lets it.
SLOPE_STEP = 1e-4


@dataclass(frozen=True)
class Parametrization:
    """Kinds of response and their fixed parameters: turns logarithms of rates into responses.

    Attributes
    ----------
    classes : tuple of response classes, one for each drive
    fixed : tuple of mapping, the parameters that are not fitted
    common : bool
        One kind whose rates all drives share: those of the modes of one body.
    """

    classes: tuple[Any, ...]
    fixed: tuple[Mapping[str, float], ...]
    common: bool = False

    @property
    def searched(self) -> int:
        """Number of parameters that enter nonlinearly."""
        return sum(len(cls.searched) for cls in self._own)

    @property
    def _own(self) -> tuple[Any, ...]:
        """Those kinds that have rates of their own."""
        return self.classes[:1] if self.common else self.classes

    @property
    def apart(self) -> Parametrization:
        """The same kinds, each drive with rates of its own."""
        return replace(self, common=False)

    def parts(self, theta: NDArray[Any]) -> list[NDArray[Any]]:
        """What each drive has of `theta`, also where it is shared.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
        """
        if self.common:
            return [theta] * len(self.classes)
        ends = [0, *accumulate(len(cls.searched) for cls in self.classes)]
        return [theta[start:stop] for start, stop in pairwise(ends)]

    @property
    def gains(self) -> int:
        """Number of gains."""
        return sum(len(cls.gains) for cls in self.classes)

    def limits(
        self, period: float, duration: float, free_start: bool = False, longest: float = np.inf
    ) -> tuple[Float, Float]:
        """Least and largest logarithms, each shape (searched,).

        A lag far longer than the records is a trend, and its gain a guess; behind a free start none
        is longer than they are: it could not be told from what the machine brings along.

        Parameters
        ----------
        period, duration : float [s]
            Shortest sample period and longest duration of the records.
        free_start : bool
        longest : float [s]
            See `CalibrationProblem`; of lags. Of other kinds `impossible` asks it.
        """
        lag = min(duration * (SLOWEST_FREE if free_start else SLOWEST), longest)
        duration = lag / SLOWEST_KNOWN
        boxes = [
            cls.search_box(period, duration, **fixed)[name]
            for cls, fixed in zip(self._own, self.fixed, strict=False)
            for name in cls.searched
        ]
        low, high = np.log(boxes).T
        return low, high

    def starts(self, period: float, duration: float) -> list[Float]:
        """Logarithms to start from, of every response side by side; parameters as `limits`.

        Several drives share their place in the grid.
        """
        lists = [
            cls.starts(period, duration, **fixed)
            for cls, fixed in zip(self._own, self.fixed, strict=False)
        ]
        longest = max(map(len, lists))
        joint = [sum((each[k % len(each)] for each in lists), ()) for k in range(longest)]
        return [np.log(start) for start in joint]

    def names(self) -> list[str]:
        """Names of the searched parameters, then of the gains; with [k] for one of each drive."""
        return [
            f"{name}[{k}]" if len(own) > 1 else name
            for group, own in (("searched", self._own), ("gains", self.classes))
            for k, cls in enumerate(own)
            for name in getattr(cls, group)
        ]

    def split(self, theta: Float) -> list[dict[str, float]]:
        """Searched parameters of each response, from their logarithms."""
        return [
            dict(zip(cls.searched, np.exp(own).tolist(), strict=True))
            for cls, own in zip(self.classes, self.parts(theta), strict=True)
        ]

    def excess(self, theta: Float) -> float:
        """How far `theta` (logarithms) is beyond what its kinds can be followed at; 0 within."""
        parts = zip(self.classes, self.split(theta), strict=True)
        bounded = [(cls.search_excess, own) for cls, own in parts if hasattr(cls, "search_excess")]
        return float(sum(excess(**own) for excess, own in bounded))

    def responses(self, theta: Float, gains: Float) -> tuple[Response, ...]:
        """The responses that `theta` (logarithms) and `gains` stand for."""
        built, at = [], 0
        for cls, fixed, searched in zip(self.classes, self.fixed, self.split(theta), strict=True):
            values = gains[at : at + len(cls.gains)].tolist()
            built.append(cls(**searched, **dict(zip(cls.gains, values, strict=True)), **fixed))
            at += len(cls.gains)
        return tuple(built)

    def unit_weights(self, theta: Float, grid: RelaxationGrid, kept: bool = False) -> Float:
        """Grid weights of each gain set to one; shape (drives · n, gains).

        Parameters
        ----------
        theta : ndarray, shape (searched,)
            Logarithms.
        grid : RelaxationGrid
        kept : bool
            Whether they are asked for again and again, as those of the starts of a search.
        """
        n, at = len(grid.rates), 0
        unit = np.zeros((n * len(self.classes), self.gains))
        for k, searched in enumerate(self.split(theta)):
            own = self._own_weights(k, searched, grid, kept)
            unit[k * n : (k + 1) * n, at : at + own.shape[1]] = own
            at += own.shape[1]
        return unit

    def unit_slopes(
        self, theta: Float, grid: RelaxationGrid, central: bool = True
    ) -> Iterator[Float]:
        """Derivatives of `unit_weights` by each parameter.

        Parameters
        ----------
        theta : ndarray, shape (searched,)
            Logarithms.
        grid : RelaxationGrid
        central : bool
            By differences to both sides; to one, with half the work, where a search need not end
            at its very minimum.

        Yields
        ------
        ndarray, shape (drives · n, gains)
        """
        if self.common:
            yield from self._common_slopes(theta, grid, central)
            return
        n, at = len(grid.rates), 0
        for k, searched in enumerate(self.split(theta)):
            gains = slice(at, at + len(self.classes[k].gains))
            at = gains.stop
            back = SLOPE_STEP if central else 0.0
            here = None if central else self._own_weights(k, searched, grid)
            for name, value in searched.items():
                moved = {**searched, name: value * np.exp(SLOPE_STEP)}
                ahead, behind = self._own_weights(k, moved, grid), here
                if behind is None:
                    moved = {**searched, name: value * np.exp(-SLOPE_STEP)}
                    behind = self._own_weights(k, moved, grid)
                slope = np.zeros((n * len(self.classes), self.gains))
                slope[k * n : (k + 1) * n, gains] = (ahead - behind) / (SLOPE_STEP + back)
                yield slope

    def _common_slopes(self, theta: Float, grid: RelaxationGrid, central: bool) -> Iterator[Float]:
        """Slopes of one drive's weights, the same for every drive."""
        one = Parametrization(self.classes[:1], self.fixed[:1])
        for slope in one.unit_slopes(theta, grid, central):
            yield np.asarray(np.kron(np.eye(len(self.classes)), slope), float)

    def _own_weights(
        self, k: int, searched: Mapping[str, float], grid: RelaxationGrid, kept: bool = False
    ) -> Float:
        """Grid weights of one response, each gain set to one; shape (n, gains)."""
        # The design has the delay (`CalibrationProblem.assemble`).
        fixed = {name: 0.0 if name == "delay" else value for name, value in self.fixed[k].items()}
        weights = _kept_weights if kept else _unit_weights
        return weights(self.classes[k], (*searched.items(), *fixed.items()), grid)


def _unit_weights(cls: Any, values: tuple[tuple[str, float], ...], grid: RelaxationGrid) -> Float:
    """Grid weights of a kind of response, each gain set to one; shape (n, gains)."""
    known = dict(values)
    if hasattr(cls, "unit_steps"):
        return grid.weights_of(*cls.unit_steps(grid.times, **known))
    return np.column_stack(
        [
            grid.weights(cls(**known, **{other: float(other == gain) for other in cls.gains}))
            for gain in cls.gains
        ]
    )


@lru_cache(maxsize=KEPT_STARTS)
def _kept_weights(cls: Any, values: tuple[tuple[str, float], ...], grid: RelaxationGrid) -> Float:
    """`_unit_weights` where a comparison comes back to them: not to be written into."""
    return _unit_weights(cls, values, grid)
