"""The model document: drives → terms → outputs, and the effects on them; one JSON file.

A drive is a channel that is known (in the log) or to be estimated; a term takes one drive through
one response; an output is a channel, the sum of its terms. An output with the role "sensor" is one
from which unknown drives are estimated. An effect is a physical cause that changes a drive, the
loss of heat or an output (`thermaltool.effects`). `design` holds the estimator that ``regularize``
made.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from thermaltool.documents import above_zero
from thermaltool.effects.band import ScheduleBand
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model.redundancy import Redundancy
from thermaltool.model.simulate import simulate
from thermaltool.model.step import ModelRecursion
from thermaltool.record import Record
from thermaltool.responses import Response, parameter_names
from thermaltool.responses.modes import Float, Hold
from thermaltool.units import Reference

Role = Literal["sensor", "deflection"]


@dataclass(frozen=True)
class Drive:
    """An input of the machine.

    Attributes
    ----------
    channel : str
    hold : "zero" or "first"
        Between samples: constant (heat, voltage, speed), or a straight line (a temperature).
    reference : "first" or float
        What counts as no drive; "first" is the level of the log's first rows (the machine is taken
        to be at rest there; `thermaltool.model.rest`).
    range : (float, float)
        Values, relative to the reference, that the calibration has seen.
    rest : float, optional
        Where the calibration began: at another level rest has other temperatures (`rest_shifts`).
        An estimator counts from it (`zero`).
    changes : tuple of float
        The largest change that the calibration has seen within 1, 2, 4 ... sample periods.
    """

    channel: str
    hold: Hold
    reference: Reference
    range: tuple[float, float]
    rest: float | None = None
    changes: tuple[float, ...] = ()

    @property
    def zero(self) -> Reference:
        """What an estimator counts from, which cannot know how the machine came to be as it is.

        Of a temperature the level at which the calibration began: a machine that is warm when a
        log or a stream begins is not taken to be at rest. "first" where no level is known.
        """
        return self.rest if self.reference == "first" and self.rest is not None else self.reference


@dataclass(frozen=True)
class Output:
    """A channel that the model computes.

    Attributes
    ----------
    channel : str
    role : "sensor" or "deflection"
    offset : "first" or float
        Its value at rest; "first" where the zero is arbitrary (a displacement): the median of
        measured minus simulated over the first rows of a log.
    range : (float, float)
        Values, relative to rest, that the calibration has seen.
    fit : mapping
        Statistics of the calibration.
    changes : tuple of float
        As of a `Drive`.
    """

    channel: str
    role: Role
    offset: Reference
    range: tuple[float, float]
    fit: Mapping[str, Any] = field(default_factory=dict)
    changes: tuple[float, ...] = ()

    @property
    def judged(self) -> bool:
        """Whether the model is to come near its readings.

        Not where they are the contact by which a calibrated joint is told: how far they depart from
        the linear model is what is read there.
        """
        return not self.fit.get("contact")

    @property
    def chosen(self) -> Mapping[str, Any]:
        """The kinds of response that were chosen, as JSON; empty where none were compared."""
        return next((each for each in self.fit.get("candidates", ()) if each["chosen"]), {})


@dataclass(frozen=True)
class Term:
    """One drive through one response into one output.

    Attributes
    ----------
    drive, output : str
    response : Response
    covariance : ndarray, shape (n, n), or None
        Of the fitted parameters, in the order of `covariance_names`.
    covariance_names : tuple of str
    band : ScheduleBand or None
        Its place among terms that are scheduled by level.
    """

    drive: str
    output: str
    response: Response
    covariance: Float | None = None
    covariance_names: tuple[str, ...] = ()
    band: ScheduleBand | None = None

    def document(self) -> dict[str, Any]:
        """As JSON."""
        response = self.response
        names = parameter_names(response.kind)
        band = {} if self.band is None else {"band": self.band.document()}
        return {
            "drive": self.drive,
            "output": self.output,
            "kind": response.kind,
            "parameters": {name: getattr(response, name) for name in names},
            "covariance": None if self.covariance is None else np.asarray(self.covariance).tolist(),
            "covariance_names": list(self.covariance_names),
            **band,
        }


@dataclass(frozen=True)
class Model:
    """Drives, terms, outputs and effects: a machine, as a calibration has found it.

    Attributes
    ----------
    drives : tuple of Drive
    outputs : tuple of Output
    terms : tuple of Term
    sample_period : float [s]
        Of the logs of the calibration.
    provenance : mapping
        Where it comes from: hashes of the logs, the command.
    design : mapping or None
        The estimator that ``regularize`` made, as JSON.
    effects : tuple of Effect
    redundancy : Redundancy or None
        How drives move together, where others can stand in for one that is lost.
    """

    drives: tuple[Drive, ...]
    outputs: tuple[Output, ...]
    terms: tuple[Term, ...]
    sample_period: float
    provenance: Mapping[str, Any] = field(default_factory=dict)
    design: Mapping[str, Any] | None = None
    effects: tuple[Effect, ...] = ()
    redundancy: Redundancy | None = None

    @property
    def sensors(self) -> tuple[Output, ...]:
        """Outputs from which unknown drives are estimated."""
        return tuple(o for o in self.outputs if o.role == "sensor")

    @property
    def deflections(self) -> tuple[Output, ...]:
        """Outputs that are to be compensated; not the contact by which a joint is told."""
        return tuple(o for o in self.outputs if o.role == "deflection" and o.judged)

    def reference(self, channel: str) -> Reference:
        """What counts as zero of a channel that is read: that of a drive, else 0.

        Parameters
        ----------
        channel : str
        """
        return next((d.reference for d in self.drives if d.channel == channel), 0.0)

    def with_design(self, design: Mapping[str, Any]) -> Model:
        """The same model with an estimator, tied to the parameters that it was designed for.

        Parameters
        ----------
        design : mapping
            As an estimator gives it (`document`).
        """
        return replace(self, design={**design, "parameters_sha256": self.parameters_digest()})

    def parameters_digest(self) -> str:
        """Identifies terms and effects: a design belongs to one set of parameters."""
        parts = [t.document() for t in self.terms]
        parts += [effect.document() for effect in self.effects]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def estimator_design(self) -> Mapping[str, Any]:
        """The design, when it is there and belongs to these parameters.

        Raises
        ------
        ModelError
        """
        if self.design is None:
            raise ModelError("the model has no estimator yet: run thermaltool regularize")
        if self.design.get("parameters_sha256") != self.parameters_digest():
            raise ModelError(
                "the estimator was designed for other parameters: run thermaltool regularize again"
            )
        known, read = [o.channel for o in self.outputs], self.design.get("sensors")
        if not isinstance(read, list) or any(sensor not in known for sensor in read):
            raise ModelError(
                "the estimator reads a sensor that the model does not have: "
                "run thermaltool regularize again"
            )
        return self.design

    def design_period(self) -> float:
        """Sample period of the estimator [s], which may not be that of the calibration.

        Raises
        ------
        ModelError
            No such number, or one of those of `estimator_design`.
        """
        design = self.estimator_design()
        return above_zero(design.get("sample_period_s", self.sample_period))

    def simulate(self, record: Record) -> dict[str, Float]:
        """Outputs of every channel, relative to rest.

        Parameters
        ----------
        record : Record
            The drives, without NaN, and what the effects need. Effects that belong to one record
            (its digest) act in that one alone.

        Returns
        -------
        dict of channel to ndarray, shape (n,)

        Raises
        ------
        ModelError
            A drive, or a channel that an effect needs, is missing.
        """
        return simulate(self, record)

    def recursion(self, digest: str = "", period: float | None = None) -> ModelRecursion:
        """The same row by row: see `ModelRecursion`.

        Parameters
        ----------
        digest : str
            Of the record: effects that are confined to one act in that one alone.
        period : float, optional [s]
            The shortest sample that comes; that of the model by default.
        """
        return ModelRecursion(self, digest, period)

    def needs(self) -> tuple[str, ...]:
        """Channels that a simulation reads: drives, and what the effects need."""
        own = [*(d.channel for d in self.drives), *(c for e in self.effects for c in e.needs())]
        own += [term.band.channel for term in self.terms if term.band is not None]
        return tuple(dict.fromkeys(own))
