"""The paths of known inputs through a model: measured drives, sources, states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.effects.joint_contact import JointContact
from thermaltool.estimation.cascade import lagged_modes
from thermaltool.estimation.known_inputs import KnownInput
from thermaltool.estimation.permanent_effects import (
    permanent_effects,
    sensor_time_constants,
    spreading_joints,
)
from thermaltool.estimation.variable_cooling import cooling_effects
from thermaltool.model import Model, Term
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Modes
from thermaltool.responses.parallel import InputPath
from thermaltool.units import hold_of, source_rest


@dataclass(frozen=True)
class InputPaths:
    """Paths from known inputs to sensors and deflections.

    Attributes
    ----------
    model : Model
    dt : float [s]
    measured : sequence of str
        Drives that are read.
    sensors, outputs : tuple of str
        Those that count.
    """

    model: Model
    dt: float
    measured: Sequence[str]
    sensors: tuple[str, ...]
    outputs: tuple[str, ...]

    def response(self, term: Term) -> Modes:
        """A term as its sensor answers, or as a deflection follows.

        Parameters
        ----------
        term : Term
        """
        return lagged_modes(term.response.modes(self.dt), *self._sensor_lags(term.output))

    def _sensor_lags(self, target: str) -> list[float]:
        """Time constants of the sensor that reads `target`; a deflection is not read."""
        return [] if target in self.outputs else sensor_time_constants(self.model, target)

    @cached_property
    def known(self) -> tuple[KnownInput, ...]:
        """Columns to be read, each in each role once."""
        drives = {d.channel: d for d in self.model.drives if d.channel in self.measured}
        acting = [t for t in self.model.terms if t.output in (*self.sensors, *self.outputs)]
        found = [
            KnownInput(d.channel, d.hold, "drive", band)
            for d in drives.values()
            for band in dict.fromkeys(t.band for t in acting if t.drive == d.channel)
        ]
        for chooser in (t.band.channel for t in acting if t.band is not None):
            drive = drives.get(chooser)
            hold = hold_of(chooser) if drive is None else drive.hold
            if drive is None or chooser not in {k.channel for k in found}:
                found.append(KnownInput(chooser, hold, "state" if drive is None else "drive"))
        found += [_source(e) for e in self._sources()]
        for joint in self.joints:
            found.append(_contact(joint))
            if joint.partner is not None:
                found.append(_partner(joint))
        found += [
            KnownInput(c, hold_of(c), "state")
            for e in cooling_effects(self.model)
            for c in e.needs()
        ]
        return tuple(dict.fromkeys(found))

    def _sources(self) -> Iterator[Effect]:
        for effect in permanent_effects(self.model):
            reached = (effect.paths(o) for o in (*self.sensors, *self.outputs))
            if effect.side == "source" and any(reached):
                yield effect

    @cached_property
    def joints(self) -> tuple[JointContact, ...]:
        """Joints by which outputs bend together."""
        return spreading_joints(self.model)

    def redirected(self, target: str) -> Iterator[tuple[str, Modes]]:
        """What a joint adds to an output for what the linear model has at the contact, by drive.

        The rest of it is a path from what is read there.

        Parameters
        ----------
        target : str
        """
        for joint in self.joints:
            _, _, contact, deviation = joint.gains(target)
            for term in self.model.terms:
                if term.output != joint.partner:
                    continue
                late = (joint.parameters.get("time_constant", 0.0),)
                for gain, lags in ((contact, ()), (deviation, late)):
                    if gain:
                        yield term.drive, self._times(-gain, term, target, lags)

    def _times(self, gain: float, term: Term, target: str, lags: tuple[float, ...]) -> Modes:
        """A term through lags, as `target` is read, times a gain."""
        found = lagged_modes(term.response.modes(self.dt), *lags, *self._sensor_lags(target))
        parts = {name: gain * getattr(found, name) for name in ("weights", "double", "direct")}
        return replace(found, **parts)

    def _of_joints(self, targets: tuple[str, ...]) -> Iterator[InputPath]:
        for joint in self.joints:
            tau = joint.parameters.get("time_constant", 0.0)
            by = self.known.index(_contact(joint))
            for k, target in enumerate(targets):
                forces, heat, contact, deviation = joint.gains(target)
                if forces:
                    yield k, by, self._first_order(target, forces, 0.0)
                if heat:
                    yield k, by, self._first_order(target, heat, tau)
                read = None if joint.partner is None else self.known.index(_partner(joint))
                if contact and read is not None:
                    yield k, read, self._first_order(target, contact, 0.0)
                if deviation and read is not None:
                    yield k, read, self._first_order(target, deviation, tau)
        for k, target in enumerate(targets):
            for drive, modes in self.redirected(target):
                for source, known in enumerate(self.known):
                    if known.role == "drive" and known.channel == drive:
                        yield k, source, modes

    def to(self, targets: tuple[str, ...]) -> tuple[InputPath, ...]:
        """The paths that end in `targets` (the sensors, or the deflections).

        Parameters
        ----------
        targets : tuple of str
        """
        paths: list[InputPath] = []
        for term in self.model.terms:
            for source, known in enumerate(self.known):
                own = KnownInput(known.channel, known.hold, "drive", term.band)
                if term.output in targets and term.drive == known.channel and known == own:
                    modes = self.response(term)
                    if isinstance(modes, DelayedModes):
                        modes = replace(modes, period=self.dt)
                    paths.append((targets.index(term.output), source, modes))
        for effect in self._sources():
            source = self.known.index(_source(effect))
            for k, target in enumerate(targets):
                for path in effect.paths(target):
                    paths.append((k, source, self._first_order(target, *path)))
        return (*paths, *self._of_joints(targets))

    def _first_order(self, target: str, gain: float, time_constant: float) -> Modes | float:
        """A first-order lag, or a gain at once, as it is read."""
        lags = [time_constant] if time_constant > 0 else []
        lags += self._sensor_lags(target)
        if not lags:
            return gain
        first, *others = lags
        modes = Modes(np.array([-1 / first], complex), np.array([gain / first], complex))
        return lagged_modes(modes, *others)


def _source(effect: Effect) -> KnownInput:
    rest = effect.parameters.get("rest", source_rest(effect.channel))
    return KnownInput(effect.channel, hold_of(effect.channel), "source", rest=rest)


def _contact(joint: JointContact) -> KnownInput:
    return KnownInput(joint.channel, hold_of(joint.channel), "contact")


def _partner(joint: JointContact) -> KnownInput:
    assert joint.partner is not None
    rest = source_rest(joint.partner)
    return KnownInput(joint.partner, hold_of(joint.partner), "source", rest=rest)
