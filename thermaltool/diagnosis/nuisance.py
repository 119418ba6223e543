"""What a model may say for itself of one output, and what its calibration knows of that.

The nuisance of an output are moves of the model's own parameters (of logarithms where they are
searched so) and lags of the drives, which stand for what a response's kind leaves out of its shape,
both with a prior; decays of an unknown state at the first row; the offset of every log; and the
parameters of the effects that the model holds already.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from thermaltool.diagnosis.assumptions import Assumptions
from thermaltool.diagnosis.correction import known_discrepancy
from thermaltool.diagnosis.held_effects import accepted_effects, calibrated_effects
from thermaltool.diagnosis.priors import Prior, root_of
from thermaltool.diagnosis.readings import as_readings, stand_still
from thermaltool.diagnosis.simulation import Series, SimulatedLogs
from thermaltool.diagnosis.starts import decays_of, mode_starts, uniform_starts
from thermaltool.diagnosis.switching import earlier_of, instants_of
from thermaltool.effects.dynamics import lagged
from thermaltool.effects.effect import Float
from thermaltool.model import Model
from thermaltool.responses import Response
from thermaltool.signals.detrend import difference_sigma
from thermaltool.signals.row_groups import RowGroups
from thermaltool.signals.symmetric import eigh

# A wide prior: what a parameter may be where nothing was calibrated before. Of a logarithm, and
# of a gain relative to what makes as much as the strongest of its response.
WIDE_LOG, WIDE_GAIN = 1.0, 1.0
# Where a model is free, its lags are so many times apart.
MIN_LAG_RATIO = 3.0
# A discrepancy slower than the calibration has shown is at most this share of the white noise; one
# counts as shown up to this many of its time constants.
MIN_FLOOR, SHOWN_TIME_CONSTANTS = 0.5, 2.0
# Directions of a prior that change a whole log by less, over the noise of a reading, are left out.
MIN_CHANGE = 0.1
# The noise of a sensor that repeats readings may be smaller by this factor than at the calibration;
# where nothing is known of it, it is no smaller than this share of the residual.
MIN_NOISE_RATIO, MIN_NOISE_SHARE = 0.7, 1e-3
# Smallest white noise [unit of the channel].
MIN_WHITE = 1e-12
# Relative move of an own parameter from which its slope is taken.
OWN_MOVE = 1e-3


@dataclass(frozen=True)
class OwnParameter:
    """A parameter of the model itself.

    Attributes
    ----------
    term : int
    name : str
    log : bool
        Counted by its logarithm.
    """

    term: int
    name: str
    log: bool


@dataclass(frozen=True, eq=False)
class OutputNuisance:
    """What may explain the residual of one output for free.

    Attributes
    ----------
    simulation : SimulatedLogs
    calibrated : Model
        The model as its calibration knows it: the centre of the priors.
    assumptions : frozenset of str
        Groups of nuisance in use.
    output : str
    """

    simulation: SimulatedLogs
    calibrated: Model
    assumptions: Assumptions
    output: str

    # ------------------------------------------------------------ noise and discrepancy

    @cached_property
    def _known(self) -> Mapping[str, Any]:
        """What the calibration knows of the output beyond its kind of response; may be empty."""
        return known_discrepancy(self.calibrated, self.output)

    @property
    def groups(self) -> RowGroups:
        """Rows of the output that count."""
        return self.simulation.groups[self.output]

    @cached_property
    def white(self) -> float:
        """White noise of a reading, from the differences of neighbours.

        A sensor that stands still is no quiet sensor: it has about the noise of the calibration.
        """
        residual = as_readings(self.simulation, self.output, self.simulation.residual(self.output))
        least = MIN_NOISE_SHARE * float(np.std(residual))
        if "tight" in self.assumptions:
            still = stand_still(self.simulation, self.output)
            least = still * MIN_NOISE_RATIO * float(self._known.get("white_sigma", 0.0))
        return max(difference_sigma(residual), least, MIN_WHITE)

    def floor(self, tau: float = np.inf) -> float:
        """Discrepancy of the calibration.

        Parameters
        ----------
        tau : float [s]
            Its time constant or longest one. A slower one than the calibration has shown is at
            most a share of the white noise.
        """
        least = MIN_FLOOR * self.white
        if not self._known or tau > self._shown:
            return least
        return max(float(self._known["drift_sigma"]), least)

    @property
    def _shown(self) -> float:
        """Slowest time constant of a discrepancy that the calibration has shown [s]."""
        return SHOWN_TIME_CONSTANTS * self._known["drift_time_s"] if self._known else 0.0

    @property
    def expected(self) -> Callable[[float], float] | None:
        """Discrepancy of a clean log by its time constant [s]; None where the model is free."""
        if "tight" not in self.assumptions:
            return None
        slow, fast = self.floor(), self.floor(0.0)
        shown = self._shown
        return lambda tau: fast if tau <= shown else slow

    # ------------------------------------------------------------ the model's own parameters

    @cached_property
    def own(self) -> list[OwnParameter]:
        """The parameters of the model that the output depends on."""
        found = []
        for k, term in enumerate(self.simulation.model.terms):
            if term.output == self.output:
                cls = type(term.response)
                found += [OwnParameter(k, name, True) for name in cls.searched]
                found += [OwnParameter(k, name, False) for name in cls.gains]
        return found

    def moved(self, steps: Float) -> Model:
        """The model with the output's own parameters moved.

        Parameters
        ----------
        steps : ndarray, shape (p,)
            Of logarithms where they are counted so.

        Raises
        ------
        ValueError
            A response does not allow it.
        """
        model = self.simulation.model
        terms = list(model.terms)
        for each, step in zip(self.own, steps.tolist(), strict=True):
            term = terms[each.term]
            value = getattr(term.response, each.name)
            value = value * np.exp(step) if each.log else value + step
            terms[each.term] = replace(term, response=replace(term.response, **{each.name: value}))  # type: ignore[type-var]
        return replace(model, terms=tuple(terms))

    @property
    def sensitivities(self) -> list[Series]:
        """Change of the output per unit of each of its own parameters."""
        return [self._slope(k, own) for k, own in enumerate(self.own)]

    def _slope(self, k: int, own: OwnParameter) -> Series:
        """Change of the output per unit of its parameter `k`."""
        steps = np.zeros(len(self.own))
        response = self.simulation.model.terms[own.term].response
        steps[k] = OWN_MOVE * (1.0 if own.log else _gain_scale(response))
        try:
            model = self.moved(steps)
        except ValueError:  # at the end of its range: the other way
            steps[k] = -steps[k]
            model = self.moved(steps)
        moved = model.terms[own.term].response
        return self.simulation.slopes.of_term(own.term, own.name, moved, float(steps[k]))

    @cached_property
    def lags(self) -> list[Series]:
        """Lags of the drives, of unit height: what a response's kind leaves out of its shape."""
        simulation = self.simulation
        holds = {d.channel: d.hold for d in simulation.model.drives}
        logs = list(zip(simulation.logs, simulation.inputs, simulation.dead_times, strict=True))
        return [
            [
                np.interp(
                    log.time - late[drive],
                    log.time,
                    lagged(log.time, each[drive], tau, holds[drive]),
                    left=0.0,
                )
                for log, each, late in logs
            ]
            for drive, tau in self._lag_bank
        ]

    @property
    def _lag_bank(self) -> Sequence[tuple[str, float]]:
        """Drive and time constant [s] of each lag that the calibration knows."""
        lags: Sequence[tuple[str, float]] = self._known.get("lags", ())
        return lags

    @property
    def moving(self) -> list[str]:
        """Drive of each column of `moves`."""
        terms = self.simulation.model.terms
        return [terms[e.term].drive for e in self.own] + [drive for drive, _ in self._lag_bank]

    @cached_property
    def moves(self) -> Series:
        """Change of the output per unit of each of its `own` parameters and `lags`, (n, p + q)."""
        columns = [*self.sensitivities, *self.lags]
        return [np.column_stack([c[k] for c in columns]) for k in range(len(self.simulation.logs))]

    # ------------------------------------------------------------ priors

    @property
    def group(self) -> str:
        """Group of nuisance in which the model's own parameters move."""
        return "released" if "released" in self.assumptions else "tight"

    @property
    def prior(self) -> Prior:
        """What moves may be under the assumptions: of no size where they are in none."""
        if self.group not in self.assumptions:
            none = np.zeros((len(self.moving), 0))
            return Prior(none, np.zeros(0), none.T)
        return self.free_prior if self.group == "released" else self.calibrated_prior

    @cached_property
    def free_prior(self) -> Prior:
        """What moves may be where nothing holds the parameters."""
        at, size = self._now()
        # A lag at the largest drive is of the size of the noise; some of them say what all do.
        lags = self._lag_bank
        heights = np.array([self.white / self.simulation.level(drive) for drive, _ in lags])
        root = block_diag(np.diag(size), np.diag(heights)[:, _apart(lags)])
        inverse = np.asarray(np.linalg.pinv(root), np.float64)
        return Prior(root, inverse @ np.append(at, np.zeros(len(lags))), inverse)

    @cached_property
    def calibrated_prior(self) -> Prior:
        """What moves may be within the calibration, in directions that these logs show."""
        own, known = self.own, self._known
        at, size = self._now()
        if not known:
            covariance = np.zeros((len(own), len(own)))
            for term in {e.term for e in own}:
                index = [k for k, e in enumerate(own) if e.term == term]
                block = self._calibrated_covariance([own[k] for k in index])
                covariance[np.ix_(index, index)] = block
        else:
            names = [tuple(name) for name in known["parameters"]]
            mine = [(self.simulation.model.terms[e.term].drive, e.name) for e in own]
            if sorted(names) != sorted(mine):
                return self.free_prior
            # A fit has what it searched first, then the gains; a model has drive after drive.
            order = [*map(names.index, mine), *range(len(own), len(known["covariance"]))]
            covariance = np.array(known["covariance"])[np.ix_(order, order)]
            q = len(covariance) - len(own)
            at = np.append(at, np.zeros(q))
            size = np.append(size, np.broadcast_to(known["lag_sigma"], q))
        columns = as_readings(self.simulation, self.output, self.moves)
        root = root_of(covariance, size)
        if spread := known.get("spread"):
            # Which of several fits is true the calibration could not tell.
            differ = np.pad(np.array(spread), ((0, 0), (len(own), 0)))
            root = root_of(root @ root.T + differ.T @ differ / len(differ))
        changes = columns @ root
        changes = changes - changes.mean(axis=0)
        values, vectors = eigh(changes.T @ changes)
        # The most visible direction first.
        turn = vectors[:, values > (MIN_CHANGE * self.white) ** 2][:, ::-1]
        inverse = turn.T @ np.linalg.inv(root)
        return Prior(root @ turn, inverse @ at, inverse)

    def _now(self) -> tuple[Float, Float]:
        """How far the own parameters are from the calibration, and how far they may be at most."""
        at = np.zeros(len(self.own))
        for k, each in enumerate(self.own):
            now = getattr(self.simulation.model.terms[each.term].response, each.name)
            was = getattr(self.calibrated.terms[each.term].response, each.name)
            at[k] = np.log(now / was) if each.log else now - was
        return at, self.wide(self.own)

    def wide(self, own: Sequence[OwnParameter]) -> Float:
        """How far own parameters may be from the calibration at most, shape (p,)."""
        sizes = self._gain_sizes
        return np.array([WIDE_LOG if e.log else WIDE_GAIN * sizes[e.term, e.name] for e in own])

    @cached_property
    def _gain_sizes(self) -> dict[tuple[int, str], float]:
        """Of each gain what makes as much as the strongest one of its response does.

        Gains of one response may differ in unit, as A and D of A a/(s + a) + D s/(s + d)².
        """
        slopes = [float(np.sqrt(np.mean(np.concatenate(s) ** 2))) for s in self.sensitivities]
        makes = {(e.term, e.name): s for e, s in zip(self.own, slopes, strict=True) if not e.log}
        sizes = {}
        for (term, name), slope in makes.items():
            response = self.simulation.model.terms[term].response
            most = max(abs(getattr(response, n)) * makes[term, n] for n in response.gains)
            known = most > 0 and slope > 0
            sizes[term, name] = most / slope if known else _gain_scale(response)
        return sizes

    def _calibrated_covariance(self, own: Sequence[OwnParameter]) -> Float:
        """Covariance of some parameters of one term, by the fit alone."""
        term = self.calibrated.terms[own[0].term]
        if term.covariance is None:
            return np.diag(self.wide(own) ** 2)
        names = list(term.covariance_names)
        index = [names.index(e.name) for e in own]
        factor = np.array([1 / getattr(term.response, e.name) if e.log else 1.0 for e in own])
        return np.asarray(term.covariance)[np.ix_(index, index)] * np.outer(factor, factor)

    # ------------------------------------------------------------ start, offsets, accepted causes

    @cached_property
    def starts(self) -> dict[str, list[Series]]:
        """What a log that does not begin at rest adds, by how it may begin."""
        ways = {"initial": decays_of, "modes": mode_starts, "uniform": uniform_starts}
        return {way: columns(self.simulation, self.output) for way, columns in ways.items()}

    @cached_property
    def instants(self) -> list[Series]:
        """What commands that switch between the rows add, a column a switch."""
        return instants_of(self.simulation, self.output)

    @property
    def beside(self) -> dict[str, list[Series]]:
        """What is none of the moves, offsets and causes, by group; each in units of its prior."""
        return {
            "effects": self.calibrated_effects,
            **self.starts,
            "instants": self.instants if "instants" in self.assumptions else [],
            "earlier": earlier_of(self.instants) if "earlier" in self.assumptions else [],
        }

    @property
    def offsets(self) -> list[Series]:
        """One for each log that has rows, in that log."""
        logs = self.simulation.logs
        return [
            [np.full(len(log.time), float(j == k)) for j, log in enumerate(logs)]
            for k in self.groups.present
        ]

    @cached_property
    def accepted(self) -> dict[tuple[int, str], Series]:
        """Sensitivities to the parameters of accepted causes, by place and name."""
        return accepted_effects(self.simulation, self.calibrated, self.output)

    @cached_property
    def calibrated_effects(self) -> list[Series]:
        """Changes by one standard error of each parameter of the effects that were calibrated."""
        return calibrated_effects(self.simulation, self.calibrated, self.output)


def _apart(lags: Sequence[tuple[str, float]]) -> list[int]:
    """Which of the lags to keep, of every drive the first and what is far from the one before."""
    kept: list[int] = []
    for k, (drive, tau) in enumerate(lags):
        last = next((lags[j][1] for j in reversed(kept) if lags[j][0] == drive), 0.0)
        if not last or max(tau, last) >= MIN_LAG_RATIO * min(tau, last):
            kept.append(k)
    return kept


def _gain_scale(response: Response) -> float:
    """Largest gain of a response; one where all are zero."""
    return max(abs(getattr(response, name)) for name in response.gains) or 1.0
