"""Slopes of a simulated model: what small moves of its own parameters and of its effects change.

Each is simulated once, whichever output or assumption asks for it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from thermaltool.effects.effect import Effect, Float
from thermaltool.model import sum_terms
from thermaltool.model.simulate import acting_effects, read_outputs
from thermaltool.responses import Response

if TYPE_CHECKING:
    from thermaltool.diagnosis.simulation import Changes, Series, SimulatedLogs

# Moves from which slopes of effects are taken: of what is linear in one and what is not, both
# relative, and the smallest.
LINEAR_MOVE, SEARCHED_MOVE, MIN_MOVE = 1e-3, 1e-2, 1e-6


class ModelSlopes:
    """Slopes of the outputs of a model on its logs.

    Parameters
    ----------
    simulation : SimulatedLogs
    """

    def __init__(self, simulation: SimulatedLogs) -> None:
        self._simulation = simulation
        self._of_terms: dict[tuple[int, str], Series] = {}
        self._of_effects: dict[tuple[int, str], Changes] = {}
        self._responses: dict[int, list[Float]] = {}

    def of_term(self, at: int, name: str, moved: Response, step: float) -> Series:
        """Change of a term's output per unit of a parameter of its response.

        Parameters
        ----------
        at : int
            Number of the term.
        name : str
            Of the parameter.
        moved : Response
            With the parameter elsewhere.
        step : float
            By how much.
        """
        if (at, name) not in self._of_terms:
            output = self._simulation.model.terms[at].output
            changed = self._with_response(at, moved)
            self._of_terms[at, name] = [
                (new[output] - old[output]) / step
                for new, old in zip(changed, self._simulation.outputs, strict=True)
            ]
        return self._of_terms[at, name]

    def of_effect(self, at: int, name: str) -> Changes:
        """Change of every output per unit of a parameter of an effect; without those that stay.

        Parameters
        ----------
        at : int
            Number of the effect.
        name : str
            Of the parameter.
        """
        if (at, name) not in self._of_effects:
            model = self._simulation.model
            effects, step = list(model.effects), _step(model.effects[at], name)
            effects[at] = effects[at].changed({name: effects[at].parameters[name] + step})
            changed = self._simulation.with_effects(model=replace(model, effects=tuple(effects)))
            self._of_effects[at, name] = {
                output: [each / step for each in change]
                for output, change in self._simulation.change(changed).items()
            }
        return self._of_effects[at, name]

    def _with_response(self, at: int, response: Response) -> list[dict[str, Float]]:
        """Outputs of every log with another response in one term.

        An output that no effect joins with others is simulated alone.
        """
        model, simulation = self._simulation.model, self._simulation
        if any(e.side == "state" for e in model.effects):
            terms = list(model.terms)
            terms[at] = replace(terms[at], response=response)
            return simulation.with_effects(model=replace(model, terms=tuple(terms)))
        if at not in self._responses:
            self._responses[at] = self._response(at, model.terms[at].response)
        output, alone = model.terms[at].output, not any(e.joins for e in model.effects)
        runs = []
        for log, sums, old, new in zip(
            simulation.logs,
            simulation.responses,
            self._responses[at],
            self._response(at, response),
            strict=True,
        ):
            own = {output: sums[output] + (new - old)}
            effects = acting_effects(model, log.digest)
            runs.append(read_outputs(effects, own if alone else {**sums, **own}, log))
        return runs

    def _response(self, at: int, response: Response) -> list[Float]:
        """One term in each log, with a response."""
        model = self._simulation.model
        term = replace(model.terms[at], response=response)
        outputs = tuple(o for o in model.outputs if o.channel == term.output)
        one = replace(model, terms=(term,), outputs=outputs)
        return [
            sum_terms(one, acting_effects(model, log.digest), log)[term.output]
            for log in self._simulation.logs
        ]


def _step(effect: Effect, name: str) -> float:
    """Move of an effect's parameter from which its slope is taken."""
    relative = LINEAR_MOVE if effect.parameter(name).linear else SEARCHED_MOVE
    return max(relative * abs(effect.parameters[name]), MIN_MOVE)
