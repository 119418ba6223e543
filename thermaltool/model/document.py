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
from typing import Any, Literal, get_args

import numpy as np

from thermaltool import documents
from thermaltool.documents import MODEL, Part
from thermaltool.effects import load_effect
from thermaltool.effects.band import ScheduleBand, load_band
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model.simulate import simulate
from thermaltool.model.step import ModelRecursion
from thermaltool.record import Record
from thermaltool.responses import Response, parameter_names, response_class
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
    """

    channel: str
    hold: Hold
    reference: Reference
    range: tuple[float, float]
    rest: float | None = None


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
    """

    channel: str
    role: Role
    offset: Reference
    range: tuple[float, float]
    fit: Mapping[str, Any] = field(default_factory=dict)


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
    """

    drives: tuple[Drive, ...]
    outputs: tuple[Output, ...]
    terms: tuple[Term, ...]
    sample_period: float
    provenance: Mapping[str, Any] = field(default_factory=dict)
    design: Mapping[str, Any] | None = None
    effects: tuple[Effect, ...] = ()

    @property
    def sensors(self) -> tuple[Output, ...]:
        """Outputs from which unknown drives are estimated."""
        return tuple(o for o in self.outputs if o.role == "sensor")

    @property
    def deflections(self) -> tuple[Output, ...]:
        """Outputs that are to be compensated."""
        return tuple(o for o in self.outputs if o.role == "deflection")

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
        parts = [_term_document(t) for t in self.terms]
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


# ---------------------------------------------------------------- the file


def to_document(model: Model) -> dict[str, Any]:
    """The model as JSON-ready dict.

    Parameters
    ----------
    model : Model
    """
    document: dict[str, Any] = {
        "sample_period_s": model.sample_period,
        "drives": [
            {
                "channel": d.channel,
                "hold": d.hold,
                "reference": d.reference,
                "range": list(d.range),
                **({} if d.rest is None else {"rest": d.rest}),
            }
            for d in model.drives
        ],
        "outputs": [
            {
                "channel": o.channel,
                "role": o.role,
                "offset": o.offset,
                "range": list(o.range),
                "fit": dict(o.fit),
            }
            for o in model.outputs
        ],
        "terms": [_term_document(t) for t in model.terms],
        "provenance": dict(model.provenance),
    }
    if model.effects:
        document["effects"] = [effect.document() for effect in model.effects]
    if model.design is not None:
        document["design"] = dict(model.design)
    return MODEL.wrap(document)


def _term_document(term: Term) -> dict[str, Any]:
    response = term.response
    band = {} if term.band is None else {"band": term.band.document()}
    return {
        "drive": term.drive,
        "output": term.output,
        "kind": response.kind,
        "parameters": {name: getattr(response, name) for name in parameter_names(response.kind)},
        "covariance": None if term.covariance is None else np.asarray(term.covariance).tolist(),
        "covariance_names": list(term.covariance_names),
        **band,
    }


def dumps(model: Model) -> str:
    """The file's text: sorted keys, no clock time, no NaN.

    Parameters
    ----------
    model : Model
    """
    return MODEL.dumps(to_document(model))


def loads(text: str, name: str = "<model>") -> Model:
    """Read a model document.

    Parameters
    ----------
    text : str
    name : str
        What messages call the file.

    Raises
    ------
    ModelError
        No JSON, another format, a newer version, a part missing or out of range; each names the
        file.
    """
    document = MODEL.loads(text, name)
    try:
        return _load(Part(document))
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from error


def _load(whole: Part) -> Model:
    model = Model(
        drives=tuple(_load_drive(part) for part in whole.parts("drives")),
        outputs=tuple(_load_output(part) for part in whole.parts("outputs")),
        terms=tuple(_load_term(part) for part in whole.parts("terms")),
        sample_period=whole.read("sample_period_s", documents.above_zero),
        provenance=whole.read("provenance", documents.mapping, {}),
        design=whole.read("design", documents.bounded, None),
        effects=tuple(_load_effect(part) for part in whole.parts("effects", ())),
    )
    _check_ends(model)
    return model


def _load_drive(part: Part) -> Drive:
    return Drive(
        part.read("channel", documents.text),
        part.read("hold", documents.one_of(get_args(Hold))),
        part.read("reference", documents.rest),
        part.read("range", documents.pair),
        part.read("rest", documents.finite, None),
    )


def _load_output(part: Part) -> Output:
    return Output(
        part.read("channel", documents.text),
        part.read("role", documents.one_of(get_args(Role))),
        part.read("offset", documents.rest),
        part.read("range", documents.pair),
        part.read("fit", documents.mapping, {}),
    )


def _load_term(part: Part) -> Term:
    return Term(
        part.read("drive", documents.text),
        part.read("output", documents.text),
        _load_response(part),
        part.read("covariance", _covariance, None),
        part.read("covariance_names", documents.names, ()),
        part.read("band", _band, None),
    )


def _load_effect(part: Part) -> Effect:
    # A source that nobody logged has no channel.
    part.read("channel", lambda value: value if value == "" else documents.text(value))
    part.read("covariance", _covariance, None)
    effect: Effect = part.as_whole(load_effect)
    return effect


def _band(value: Any) -> ScheduleBand | None:
    Part(documents.mapping(value)).read("channel", documents.text)
    return load_band(value)


def _covariance(rows: Any) -> Float:
    values = np.array(rows, float)
    if values.ndim != 2 or len(set(values.shape)) > 1 or not np.isfinite(values).all():
        raise ModelError("not a square of finite numbers")
    return values


def _load_response(part: Part) -> Response:
    kind, known = part.read("kind", documents.text), part.read("kind", parameter_names)
    given = part.part("parameters")
    values = {name: given.read(name, documents.finite) for name in known}
    response: Response = part.as_whole(lambda _: response_class(kind)(**values))
    return response


def _check_ends(model: Model) -> None:
    """Terms go from a drive of the model to an output of the model, each of which is there once."""
    drives, outputs = ([each.channel for each in ends] for ends in (model.drives, model.outputs))
    for channel in (*drives, *outputs):
        if drives.count(channel) > 1 or outputs.count(channel) > 1:
            raise ModelError(f"{channel} is there twice")
    if not model.terms:
        raise ModelError("terms: there is none")
    for term in model.terms:
        if term.drive not in drives or term.output not in outputs:
            raise ModelError(f"a term from {term.drive!r} to {term.output!r}, which are not there")
