"""A hypothesis: a model with its accepted causes on the logs, and what is left to explain.

A hypothesis does not change: what is taken to be true next is another one (`replace`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from thermaltool.diagnosis.assumptions import STARTS, Assumptions, started
from thermaltool.diagnosis.correction import uncorrected
from thermaltool.diagnosis.evidence import OutputEvidence
from thermaltool.diagnosis.noise_levels import weigh
from thermaltool.diagnosis.nuisance import OutputNuisance
from thermaltool.diagnosis.simulation import Mask, Series, SimulatedLogs
from thermaltool.diagnosis.starts import beginning
from thermaltool.effects.effect import Float
from thermaltool.effects.scene import Scene
from thermaltool.model import Model
from thermaltool.record import Record
from thermaltool.signals.row_groups import RowGroups

# The model's own parameters are searched in so many steps at most, until none moves by more (of a
# logarithm, or of the largest gain); each goes this far at most (of a logarithm), whole or in part,
# and has to lower the negative log likelihood by so much.
MAX_STEPS, MIN_STEP, MAX_STEP = 6, 1e-3, 0.7
STEP_SHARES = (1.0, 0.3, 0.1)
MIN_DESCENT = 0.1
# A calibration leaves a move open up to so many of its standard deviations.
MAX_MOVE = 3.0
# Squared length of a whitened sensitivity that stands for none.
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model on logs under assumptions of what it may say for itself.

    Attributes
    ----------
    simulation : SimulatedLogs
        The model, effects included, on every log.
    calibrated : Model
        The model as its calibration knows it: the centre of the priors.
    assumptions : frozenset of str
        Groups of nuisance in use.
    near : mapping of output to OutputEvidence
        Of a model that leaves much the same: the noise is sought around it.
    """

    simulation: SimulatedLogs
    calibrated: Model
    assumptions: Assumptions
    near: Mapping[str, OutputEvidence] = field(default_factory=dict)

    @staticmethod
    def of(
        model: Model,
        logs: Sequence[Record],
        calibrated: Model,
        assumptions: Assumptions,
        masked: Mask | None = None,
    ) -> Hypothesis:
        """A model on logs.

        Parameters
        ----------
        model : Model
            Effects included.
        logs : sequence of Record
        calibrated : Model
        assumptions : frozenset of str
        masked : mapping of (digest, output) to ndarray of bool, optional
            Rows that are left out (outliers).
        """
        return Hypothesis(SimulatedLogs(model, tuple(logs), masked or {}), calibrated, assumptions)

    @property
    def model(self) -> Model:
        """The model, effects included."""
        return self.simulation.model

    @property
    def logs(self) -> tuple[Record, ...]:
        """What the model is compared with."""
        return self.simulation.logs

    @property
    def groups(self) -> dict[str, RowGroups]:
        """Rows that count, of every output that has some."""
        return self.simulation.groups

    def with_model(self, model: Model) -> Hypothesis:
        """Another model under the same assumptions."""
        return replace(self, simulation=replace(self.simulation, model=model))

    def with_logs(self, logs: Sequence[Record]) -> Hypothesis:
        """The same model on other logs."""
        return replace(self, simulation=replace(self.simulation, logs=tuple(logs)))

    def with_masked(self, masked: Mask) -> Hypothesis:
        """The same with other rows left out, and no others."""
        return replace(self, simulation=replace(self.simulation, masked=masked))

    def under(self, assumptions: Assumptions, calibrated: Model) -> Hypothesis:
        """The same under other assumptions.

        Parameters
        ----------
        assumptions : frozenset of str
        calibrated : Model
            As the calibration left it: where the model's own parameters are set free, what it knew
            of them beyond that goes.
        """
        if assumptions == self.assumptions:
            return self
        if "released" in assumptions and "tight" in self.assumptions:
            freed = self.with_model(replace(self.model, terms=calibrated.terms))
            return Hypothesis(freed.simulation, calibrated, assumptions)
        return replace(self, assumptions=assumptions)

    def written(self, calibrated: Model) -> Hypothesis:
        """The same with the model as a user gets it.

        Parameters
        ----------
        calibrated : Model
            As the calibration left it.
        """
        free = "released" in self.assumptions
        return self.with_model(uncorrected(self.model, calibrated, free))

    @cached_property
    def nuisance(self) -> dict[str, OutputNuisance]:
        """What may explain each output for free."""
        return {
            o: OutputNuisance(self.simulation, self.calibrated, self.assumptions, o)
            for o in self.groups
        }

    @cached_property
    def evidence(self) -> dict[str, OutputEvidence]:
        """Evidence of each output."""
        return {output: self._weighed(output) for output in self.groups}

    def _weighed(self, output: str) -> OutputEvidence:
        nuisance, groups = self.nuisance[output], self.groups[output]

        def matrix(columns: Sequence[Series]) -> Float:
            if not columns:
                return np.zeros((groups.size, 0))
            return np.column_stack([groups.means(series) for series in columns])

        own = groups.means(nuisance.moves)
        priors = {"released": nuisance.free_prior}
        if "tight" in self.assumptions:
            priors["tight"] = nuisance.calibrated_prior
        # Plainer starts than the present one are not asked for.
        others = STARTS - frozenset().union(self.assumptions, *started(self.assumptions))
        beside = {group: c for group, c in nuisance.beside.items() if group not in others}
        return weigh(
            groups,
            groups.means(self.simulation.residual(output)),
            {
                "offset": matrix(nuisance.offsets),
                "accepted": matrix(list(nuisance.accepted.values())),
                **{group: own @ prior.root for group, prior in priors.items()},
                **{group: matrix(columns) for group, columns in beside.items()},
            },
            {group: prior.centre for group, prior in priors.items()},
            nuisance.white,
            self.assumptions,
            nuisance.expected,
            self.near.get(output),
        )

    def unexplained(self, output: str) -> Series:
        """Residual without the nuisance: moves as far as they are open, starts, offsets and more.

        Parameters
        ----------
        output : str
        """
        nuisance, evidence = self.nuisance[output], self.evidence[output]
        moves = evidence.fitted(self.assumptions, nuisance.group)
        if nuisance.group == "tight":
            # Further off the calibration is contradicted, not open.
            centre = nuisance.prior.centre
            moves = np.clip(moves + centre, -MAX_MOVE, MAX_MOVE) - centre
        moves = nuisance.prior.root @ moves
        fitted = evidence.fitted(self.assumptions, "offset").tolist()
        offsets = dict(zip(nuisance.groups.present, fitted, strict=True))
        beside = [self._fitted_part(output, group) for group in nuisance.beside]
        return [
            residual - nuisance.moves[k] @ moves - sum(part[k] for part in beside)
            - offsets.get(k, 0.0)
            for k, residual in enumerate(self.simulation.residual(output))
        ]  # fmt: skip

    def of_logs(self, output: str) -> Series:
        """What is of the logs and none of the model: starts, and instants of switching.

        Parameters
        ----------
        output : str
        """
        return [a + b for a, b in zip(self.beginning(output), self.switching(output), strict=True)]

    def switching(self, output: str) -> Series:
        """What is of commands that switch between the rows; zero where they switch at them.

        Parameters
        ----------
        output : str
        """
        each = (self._fitted_part(output, group) for group in ("instants", "earlier"))
        return [instants + earlier for instants, earlier in zip(*each, strict=True)]

    def _fitted_part(self, output: str, group: str) -> Series:
        """One group of nuisance as it fits best; zero where it is not in use."""
        weights = self.evidence[output].fitted(self.assumptions, group).tolist()
        columns = self.nuisance[output].beside[group] if weights else []
        return [
            sum((w * c[k] for w, c in zip(weights, columns, strict=True)), np.zeros(len(log)))
            for k, log in enumerate(self.logs)
        ]

    def beginning(self, output: str) -> Series:
        """What is left of an unknown state at the first row; zero where logs begin at rest.

        Parameters
        ----------
        output : str
        """
        if "initial" not in self.assumptions:
            plain = (self._fitted_part(output, way) for way in ("modes", "uniform"))
            return [a + b for a, b in zip(*plain, strict=True)]
        return beginning(self.simulation, output)

    @cached_property
    def scene(self) -> Scene:
        """What the catalogue of causes sees."""
        residuals = {
            o: [
                residual - own
                for residual, own in zip(self.simulation.residual(o), self.of_logs(o), strict=True)
            ]
            for o in self.groups
        }
        return self.simulation.scene({o: self.white(o) for o in self.groups}, residuals)

    def white(self, output: str, assumptions: Assumptions | None = None) -> float:
        """White noise of a reading of an output as the assumptions explain it.

        Parameters
        ----------
        output : str
        assumptions : frozenset of str, optional
            The present ones by default.
        """
        return self.evidence[output].null(assumptions or self.assumptions).white

    def evidence_of(self, assumptions: Assumptions) -> float:
        """Evidence for letting the model say what other assumptions allow.

        Parameters
        ----------
        assumptions : frozenset of str
        """
        return 2 * sum(
            e.independence * (e.null(self.assumptions).best - e.null(assumptions).best)
            for e in self.evidence.values()
        )

    # ------------------------------------------------------------ the model's own parameters

    def fitted(self) -> Hypothesis:
        """The model's own parameters where the logs want them, beside the effects that it holds.

        The same where the assumptions do not free them. The steps are those of the nuisance as the
        evidence fits it, under a noise that is estimated anew after each of them: no sum of squares
        stays the same, so that this is not `signals.gauss_newton`.
        """
        return self._fitted

    @cached_property
    def _fitted(self) -> Hypothesis:
        if "released" not in self.assumptions:
            return self
        best = self
        for _ in range(MAX_STEPS):
            steps = {output: best._own_steps(output) for output in best.evidence}
            if not any(best._is_step(output, step) for output, step in steps.items()):
                break
            for share in STEP_SHARES:
                moved = best._moved(steps, share)
                if moved is not None and best._misfit(moved) < best._misfit() - MIN_DESCENT:
                    best = moved
                    break
            else:
                break
        return best if best is self else replace(best, near={})

    @cached_property
    def _fitted_beside(self) -> dict[tuple[str, ...], Hypothesis]:
        return {}

    def fitted_beside(self, logs: Sequence[Record]) -> Hypothesis:
        """The model's own parameters as these logs and others want them together.

        Parameters
        ----------
        logs : sequence of Record
            The others.
        """
        key = tuple(log.digest for log in logs)
        if key not in self._fitted_beside:
            self._fitted_beside[key] = self.with_logs((*self.logs, *logs)).fitted()
        return self._fitted_beside[key]

    def _is_step(self, output: str, steps: Float) -> bool:
        nuisance = self.nuisance[output]
        return bool(np.any(np.abs(steps) > MIN_STEP * nuisance.wide(nuisance.own)))

    def _own_steps(self, output: str) -> Float:
        """Moves of an output's own parameters that its residual asks for, none too long."""
        nuisance = self.nuisance[output]
        root = nuisance.free_prior.root[: len(nuisance.own)]
        steps = root @ self.evidence[output].fitted(self.assumptions, "released")
        logs = [abs(s) for s, each in zip(steps, nuisance.own, strict=True) if each.log]
        return np.asarray(steps * min(1.0, MAX_STEP / max([*logs, 1e-12])))

    def _moved(self, steps: Mapping[str, Float], share: float) -> Hypothesis | None:
        """The hypothesis with own parameters moved; None where a response does not allow it."""
        model = self.model
        try:
            for output, step in steps.items():
                nuisance = self.nuisance[output]
                moved, terms = nuisance.moved(share * step), {e.term for e in nuisance.own}
                model = replace(
                    model,
                    terms=tuple(
                        moved.terms[k] if k in terms else term for k, term in enumerate(model.terms)
                    ),
                )
            result = replace(self.with_model(model), near=self.evidence)
            self._misfit(result)
        except (ValueError, np.linalg.LinAlgError):
            return None
        return result

    def _misfit(self, moved: Hypothesis | None = None) -> float:
        """Negative log likelihood with the model's own parameters where they stand.

        Of the model after a move of them, under the noise and beside the nuisance before it.
        """
        fixed, result = self.assumptions - {"released"}, 0.0
        for output, evidence in self.evidence.items():
            if moved is not None:
                residual = moved.groups[output].means(moved.simulation.residual(output))
                evidence = evidence.with_residual(residual)
            result += evidence.null(fixed).best
        return result
