"""A declared body in, places for sensors out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from thermaltool.api.body_modes import thermal_modes
from thermaltool.api.result import Result
from thermaltool.api.sensor_placement import USUAL_MOST, refuse_twice
from thermaltool.errors import FitError, ModelError, counted
from thermaltool.record import hint
from thermaltool.units import UNITS, names, parse_channel

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.api.body_modes import BodyLike, BodyModes
    from thermaltool.placement.body_candidates import BodySensors, BodySites
    from thermaltool.placement.candidates import Candidates
    from thermaltool.placement.sensor_sets import SensorSet


# Noise of a reading over the largest rise, below which covariances lose their digits.
LEAST_NOISE = 1e-5


@dataclass(frozen=True, repr=False)
class BodyPlacement(Result):
    """Where on a body sensors belong.

    Attributes
    ----------
    placed : BodySensors
    doubts : tuple of str
        What the candidates and their number leave to be desired.
    """

    placed: BodySensors
    doubts: tuple[str, ...] = ()

    @property
    def sets(self) -> tuple[SensorSet, ...]:
        """For 1, 2, 3 … sensors."""
        return self.placed.sets

    @property
    def places(self) -> dict[str, tuple[float, ...]]:
        """Where the chosen sensors are [m]."""
        at = self.placed.sites.places
        return {name: tuple(at[k].tolist()) for name, k in self.placed.chosen.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before sensors are mounted, each a sentence."""
        from thermaltool.report.thermal_modes import body_notes

        return (*self.doubts, *body_notes(self.placed.modes, self.placed.body))

    def document(self) -> dict[str, Any]:
        """As ``place BODY.toml --json`` writes it."""
        from thermaltool.report.body_placement import body_placement_document

        return {**body_placement_document(self.placed), "notes": list(self.notes)}

    def table(self) -> str:
        """A row for each number of sensors, and where they are."""
        from thermaltool.report.body_placement import body_placement_table

        return body_placement_table(self.placed)

    def draw(self) -> Figure:
        """Error against the number of sensors, and where they are on the body."""
        from thermaltool.report.body_placement import draw_body_placement

        return draw_body_placement(self.placed)

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each number of sensors and output."""
        from thermaltool.report.placement import sets_frame

        return sets_frame(self.sets, self.placed.outputs)


def place_on_body(
    body: BodyLike,
    outputs: str | Sequence[str] = (),
    *,
    candidates: str | Sequence[str] = (),
    sensors: int | None = None,
    criterion: Literal["I", "A", "D", "modes"] = "I",
    reading_noise: float = 0.1,
    costs: Mapping[str, float] | None = None,
    forbid: Sequence[str] = (),
) -> BodyPlacement:
    """Where on a body of finite elements sensors belong, for deflections that are to be predicted.

    Each heat switches at random between nothing and its largest value, with each of three
    correlation times (a slowest time constant, a tenth and a hundredth of it); the criterion is the
    mean over these duty cycles.

    Parameters
    ----------
    body : str, path or mapping
        See `thermal_modes`.
    outputs : str or sequence of str, optional
        Deflections. Default: all that are declared.
    candidates : str or sequence of str, optional
        Points that are declared. Default: the nodes of the surface.
    sensors : int, optional
        How many at most. Default: 6, or as many as there are candidates; by "modes" as many as
        serve all dominant modes.
    criterion : {"I", "A", "D", "modes"}
        What stays unknown of the deflections (I) or of the temperatures of all candidates (A), what
        readings tell (D), or the rule of Zhu, Ni and Shih (2008): near extremes of the dominant
        modes, of these near the heat.
    reading_noise : float [K]
        Standard deviation of a reading.
    costs : mapping of point or boundary to float, optional
        Where a sensor of cost 1 is one of `sensors`.
    forbid : sequence of str
        Points or boundaries where no sensor can be.

    Returns
    -------
    BodyPlacement

    Raises
    ------
    ModelError
        As `thermal_modes`; no deflection, or a point or boundary that the body does not have.
    FitError
        More sensors than candidates; by "modes" fewer than the dominant modes need, or no candidate
        near a heat.
    ValueError
        A criterion of logs, a name that is given twice.

    Examples
    --------
    >>> import thermaltool as tt
    >>> found = tt.place_on_body("data_samples/bodies/rod.toml", sensors=2)
    >>> [len(each.sensors) for each in found.sets]
    [1, 2]
    """
    from thermaltool.placement.body_candidates import (
        BodySensors,
        costs_of,
        dominant_weights,
        duty_cycles_of,
        far_from_heat,
        largest_heats,
        sites_of,
    )
    from thermaltool.placement.candidates import Candidates
    from thermaltool.placement.mode_rule import DOMINANT_PART, dominant_modes
    from thermaltool.placement.optimal_design import CRITERIA, placed_sets
    from thermaltool.placement.reduction import MICROMETRES

    if criterion not in (*CRITERIA, "modes"):
        raise ValueError(f"the criterion {criterion} is of logs")
    refuse_twice(names(candidates), names(outputs))
    source = thermal_modes(body)
    modes, declared = source.modes, source.body
    targets = names(outputs) or tuple(declared.deflections)
    if not targets:
        raise ModelError(f"{source.name}: no [deflections]: what are sensors to predict?")
    for name in targets:
        if name not in declared.deflections:
            raise ModelError(f"no deflection is called {name}{hint(name, declared.deflections)}")
    sites = sites_of(modes, declared, names(candidates))
    rows = modes.equations.deflections[[list(declared.deflections).index(n) for n in targets]]
    scale = [MICROMETRES / UNITS[parse_channel(name).unit][1] for name in targets]
    largest = largest_heats(declared)
    cycles = duty_cycles_of(modes, sites, np.array(scale)[:, None] * rows, largest)
    rise = max(float(np.max(np.linalg.norm(each.readings, axis=1))) for each in cycles)
    if reading_noise < LEAST_NOISE * rise:
        raise FitError(
            f"a noise of {reading_noise:g} K beside rises of {rise:.3g} K: the least that is "
            f"computed with is {LEAST_NOISE * rise:.2g} K"
        )
    closed = np.zeros(len(sites.names), bool)
    for name in forbid:
        closed |= sites.at(declared, name)
    every = Candidates.of(
        cycles,
        reading_noise,
        costs_of(sites, declared, costs or {}),
        np.flatnonzero(closed).tolist(),
    )
    doubts = far_from_heat(modes, declared, sites, every.allowed)
    sets: tuple[SensorSet, ...]
    if criterion == "modes":
        if doubts:
            raise FitError(doubts[0])
        sets = (_rule_set(source, sites, every, largest, sensors),)
    else:
        most = min(USUAL_MOST, int(every.allowed.sum())) if sensors is None else sensors
        sets = placed_sets(every, sites.names, most, criterion)
        dominant = len(dominant_modes(dominant_weights(modes, largest)))
        if most < dominant:
            doubts.append(
                f"{counted(most, 'sensor')} for {dominant} modes that carry "
                f"{100 * DOMINANT_PART:.0f} % of the weights: readings of one moment do not tell "
                "these apart"
            )
    placed = BodySensors(
        source.name, declared, modes, targets, criterion, sets, sites, reading_noise
    )
    return BodyPlacement(placed, tuple(doubts))


def _rule_set(
    source: BodyModes,
    sites: BodySites,
    every: Candidates,
    largest: Any,
    sensors: int | None,
) -> SensorSet:
    """Sensors by the rule of the modes, and what they leave unknown."""
    from thermaltool.placement.body_candidates import dominant_weights
    from thermaltool.placement.candidates import output_errors
    from thermaltool.placement.mode_rule import place_by_modes
    from thermaltool.placement.sensor_sets import SensorSet

    if np.any(every.costs != every.costs[0]):
        raise FitError("the rule of the modes knows no costs: take --criterion I, A or D")
    closed = np.flatnonzero(~every.allowed).tolist()
    found = place_by_modes(
        sites.shapes, dominant_weights(source.modes, largest), sites.distance,
        sensors=sensors, forbidden=closed,
    )  # fmt: skip
    errors = output_errors(every, found.sensors)
    return SensorSet(tuple(sites.names[k] for k in found.sensors), tuple(errors.tolist()))
