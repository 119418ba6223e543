"""The model document as a file: drives, outputs, terms, effects and design as JSON, and back."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np

from thermaltool import documents
from thermaltool.documents import MODEL, Part
from thermaltool.effects import load_effect
from thermaltool.effects.band import ScheduleBand, load_band
from thermaltool.effects.effect import Effect
from thermaltool.errors import ModelError
from thermaltool.model.document import Drive, Model, Output, Role, Term
from thermaltool.model.redundancy import load_redundancy
from thermaltool.responses import Response, parameter_names, response_class
from thermaltool.responses.modes import Float, Hold


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
                **({"changes": list(d.changes)} if d.changes else {}),
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
                **({"changes": list(o.changes)} if o.changes else {}),
            }
            for o in model.outputs
        ],
        "terms": [t.document() for t in model.terms],
        "provenance": dict(model.provenance),
    }
    if model.effects:
        document["effects"] = [effect.document() for effect in model.effects]
    if model.redundancy is not None:
        document["redundancy"] = model.redundancy.document()
    if model.design is not None:
        document["design"] = dict(model.design)
    return MODEL.wrap(document)


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
    return from_document(MODEL.loads(text, name), name)


def from_document(document: dict[str, Any], name: str = "<model>") -> Model:
    """The model in a document, as `loads`.

    Parameters
    ----------
    document : dict
    name : str

    Raises
    ------
    ModelError
        As `loads`.
    """
    document = MODEL.check(document, name)
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
        provenance=whole.read("provenance", _provenance, {}),
        design=whole.read("design", documents.bounded, None),
        effects=tuple(_load_effect(part) for part in whole.parts("effects", ())),
        redundancy=whole.read("redundancy", load_redundancy, None),
    )
    _check_ends(model)
    return model


def _provenance(value: Any) -> dict[str, Any]:
    found = documents.mapping(value)
    logs = found.get("logs", [])
    if not isinstance(logs, list) or not all(isinstance(log, dict) for log in logs):
        raise ModelError("logs: not a list of objects")
    return found


def _load_drive(part: Part) -> Drive:
    return Drive(
        part.read("channel", documents.text),
        part.read("hold", documents.one_of(get_args(Hold))),
        part.read("reference", documents.rest),
        part.read("range", documents.pair),
        part.read("rest", documents.finite, None),
        part.read("changes", documents.rising, ()),
    )


def _load_output(part: Part) -> Output:
    return Output(
        part.read("channel", documents.text),
        part.read("role", documents.one_of(get_args(Role))),
        part.read("offset", documents.rest),
        part.read("range", documents.pair),
        part.read("fit", documents.mapping, {}),
        part.read("changes", documents.rising, ()),
    )


def _load_term(part: Part) -> Term:
    response = _load_response(part)

    def names(value: Any) -> tuple[str, ...]:
        found, known = documents.names(value), parameter_names(response.kind)
        for name in found:
            if name not in known:
                raise ModelError(f"{response.kind} has no parameter {name!r:.60}")
        return found

    fitted = part.read("covariance_names", names, ())

    def covariance(rows: Any) -> Float:
        found = _covariance(rows)
        if len(found) != len(fitted):
            raise ModelError(f"{len(found)} rows for {len(fitted)} covariance_names")
        return found

    return Term(
        part.read("drive", documents.text),
        part.read("output", documents.text),
        response,
        part.read("covariance", covariance, None),
        fitted,
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
    known = () if model.redundancy is None else model.redundancy.channels
    for channel in known:
        if channel not in drives:
            raise ModelError(f"redundancy: {channel} is no drive of the model")
    for channel in (*drives, *outputs):
        if drives.count(channel) > 1 or outputs.count(channel) > 1:
            raise ModelError(f"{channel} is there twice")
    if not model.terms:
        raise ModelError("terms: there is none")
    for term in model.terms:
        if term.drive not in drives or term.output not in outputs:
            raise ModelError(f"a term from {term.drive!r} to {term.output!r}, which are not there")
