"""Identified models of every output as a document, a table and sentences."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from thermaltool.documents import jsonable
from thermaltool.fitting.components.model import ComponentOutput
from thermaltool.fitting.document import agreement_from_rest
from thermaltool.fitting.fit import Fit
from thermaltool.fitting.linearity import MAX_P_VALUE, LinearityTest
from thermaltool.fitting.lpv.model import LpvOutput
from thermaltool.fitting.network.model import NetworkOutput
from thermaltool.fitting.screening import MIN_EVIDENCE, LeftOut
from thermaltool.fitting.subspace.model import SubspaceOutput
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.model import Model
from thermaltool.report.components import (
    component_fields,
    component_table,
    component_warnings,
)
from thermaltool.report.lpv import lpv_fields, lpv_table, lpv_warnings
from thermaltool.report.network import network_fields, network_table, network_warnings
from thermaltool.report.subspace import subspace_fields, subspace_table, subspace_warnings
from thermaltool.report.text import switched_between_rows
from thermaltool.report.transfer import (
    estimate_document,
    lost_from_rest,
    transfer_fields,
    transfer_table,
    transfer_warnings,
)
from thermaltool.units import parse_channel, printed

# A nonlinear model that fits so much less than products and powers do is not what they stand for.
MISSED_PERCENT = 3.0


@dataclass(frozen=True)
class FormReport:
    """What the models of one form have of their own.

    Attributes
    ----------
    fields : callable
        Of the fits and the place of one of them.
    table, warnings : callable
        Of all fits.
    """

    fields: Callable[[Sequence[Fit], int], dict[str, Any]]
    table: Callable[[Sequence[Fit]], str]
    warnings: Callable[[Sequence[Fit]], list[str]]


def _each_transfer_table(fits: Sequence[Fit]) -> str:
    return "\n\n".join(map(transfer_table, fits))


def _each_transfer_warnings(fits: Sequence[Fit]) -> list[str]:
    return [message for fit in fits for message in transfer_warnings(fit)]


FORMS = {
    NetworkOutput: FormReport(network_fields, network_table, network_warnings),
    SubspaceOutput: FormReport(subspace_fields, subspace_table, subspace_warnings),
    LpvOutput: FormReport(lpv_fields, lpv_table, lpv_warnings),
    ComponentOutput: FormReport(component_fields, component_table, component_warnings),
    TransferModel: FormReport(transfer_fields, _each_transfer_table, _each_transfer_warnings),
}


def _form(fits: Sequence[Fit]) -> FormReport:
    return next(form for kind, form in FORMS.items() if isinstance(fits[0].model, kind))


def identification_document(
    fits: Sequence[Fit], left_out: Sequence[LeftOut] = ()
) -> dict[str, Any]:
    """All models as plain data, each with what its form has of its own; inputs that none has."""
    fields = _form(fits).fields
    return {
        "models": [{**_document(fit), **fields(fits, k)} for k, fit in enumerate(fits)],
        "inputs_left_out": [
            {"input": each.name, "evidence": each.evidence, "same_as": each.same_as or None}
            for each in left_out
        ],
    }


def _document(fit: Fit) -> dict[str, Any]:
    m, tests, held = fit.model, fit.tests, fit.validation
    return {
        "inputs": list(m.names),
        "output": m.target,
        "sample_period_s": m.dt,
        "fit_training_percent": jsonable(fit.training.fit_percent),
        "validation": None if held is None else held.document(),
        "parameters": {name: estimate_document(e) for name, e in fit.parameters.items()},
        "offsets": list(m.offsets),
        "method": m.method,
        "converged": m.converged,
        "residuals": None
        if tests is None
        else {
            "lags": tests.lags,
            "white_p": jsonable(tests.white_p),
            "independent_p": {name: jsonable(p) for name, p in tests.independent_p.items()},
        },
        "linearity": None if fit.linearity is None else _linearity_document(fit.linearity),
        "chosen_over": None
        if fit.chosen_over is None
        else {name: jsonable(value) for name, value in asdict(fit.chosen_over).items()},
    }


def _linearity_document(test: LinearityTest) -> dict[str, Any]:
    return {
        "nonlinear": test.nonlinear,
        "matters": test.matters,
        "rms": jsonable(test.size * test.deviation),
        "p_value": jsonable(test.p_value),
        "explained": jsonable(test.explained),
        "linear_fit_percent": jsonable(test.linear_fit_percent),
        "nonlinear_fit_percent": jsonable(test.nonlinear_fit_percent),
        "term": test.term,
    }


def identification_table(fits: Sequence[Fit], reading: Sequence[str] = ()) -> str:
    """Fits, gains and time constants with their intervals, what is left.

    Parameters
    ----------
    fits : sequence of Fit
    reading : sequence of str
        Options of the command line with which the logs were read.
    """
    lines = [*map(_linearity_line, fits), *_choice_lines(fits), *_commands(fits, reading)]
    return f"{_form(fits).table(fits)}\n\n" + "\n".join(lines)


def _commands(fits: Sequence[Fit], reading: Sequence[str]) -> list[str]:
    """Lines: the commands that give the validation of rows of a log again."""
    found = []
    for each in (each for fit in fits if fit.validation for each in fit.validation.logs):
        ends = [("--start", each.start), ("--stop", each.stop)]
        if any(end is not None for _, end in ends):
            options = [f"{option} {end!r}" for option, end in ends if end is not None]
            command = [
                "simulate MODEL",
                shlex.quote(each.log.name),
                f"--initial {each.initial}",
                *options,
            ]
            found.append("validation: " + " ".join([*command, *reading]))
    return list(dict.fromkeys(found))


def identification_warnings(fits: Sequence[Fit], left_out: Sequence[LeftOut] = ()) -> list[str]:
    """What a user should know before using the models, each a sentence."""
    holds = {
        name: hold
        for fit in fits
        for name, hold in zip(fit.data.inputs, fit.data.holds, strict=True)
    }
    return [
        *_left_out(left_out), *switched_between_rows(holds), *_form(fits).warnings(fits),
        *_nonlinear(fits), *_failed(fits), *_empty(fits),
    ]  # fmt: skip


def _left_out(inputs: Sequence[LeftOut]) -> list[str]:
    """Sentences on inputs without a term, and why."""
    found = [
        f"{each.name} never moves within the rows that are fitted: it is left out"
        for each in inputs
        if each.evidence is None
    ]
    found += [
        f"{each.name} says the same as {each.same_as}: it is left out"
        for each in inputs
        if each.same_as
    ]
    silent = [each for each in inputs if each.evidence is not None and not each.same_as]
    if silent:
        most = max(silent, key=lambda each: each.evidence or 0.0)
        several = len(silent) > 1
        found.append(
            f"no evidence for {', '.join(each.name for each in silent)}: "
            f"{'they are' if several else 'it is'} left out "
            f"({'most' if several else 'it has'} {most.evidence or 0.0:.1f}"
            f"{f', {most.name}' if several else ''}; an input takes {MIN_EVIDENCE:g}); "
            "--structure oe keeps all"
        )
    return found


def _choice_lines(fits: Sequence[Fit]) -> list[str]:
    """Lines: what was taken in place of the usual structure, and why."""
    return [
        f"structure of {fit.model.target}: {over.structure}, {over.fit_percent:.1f} % of blocks "
        f"held out; {over.usual} has {over.usual_percent:.1f} %"
        for fit in fits
        if (over := fit.chosen_over) is not None
    ]


def _linearity_line(fit: Fit) -> str:
    """Whether products and powers explain the errors."""
    test, target = fit.linearity, fit.model.target
    if test is None and not fit.model.is_linear:
        return f"linearity of {target}: not tested, the model itself is not linear"
    if test is None:
        return f"linearity of {target}: too few rows, or too little error, to test"
    if test.nonlinear:
        much = "nonlinear" if test.matters else "hardly nonlinear"
        said = f"linearity of {target}: {much} (p {test.p_value:.2g}), {_reached(fit, test)}"
        if fit.model.is_linear:
            return said
        return f"{said}: hence this model{_missed(fit, test)}"
    verdict = "no products or powers in the errors"
    if test.p_value <= MAX_P_VALUE:
        verdict = "hardly anything in the errors is products or powers"
    return f"linearity of {target}: {verdict} (p {test.p_value:.2g})"


def _reached(fit: Fit, test: LinearityTest) -> str:
    """How far linear models go, and how large what they lack is."""
    size = f"{test.size * test.deviation:.2g} {printed(parse_channel(fit.model.target).unit)}"
    return (
        f"by {size.rstrip()} RMS, {100 * test.size:.2g} % of what the output moves: linear models "
        f"reach {test.linear_fit_percent:.3g} %, with products and powers "
        f"{test.nonlinear_fit_percent:.3g} % (most: {test.term})"
    )


def _missed(fit: Fit, test: LinearityTest) -> str:
    """What a nonlinear model is short of by what products and powers explain, and what to try."""
    reached, target = fit.training.fit_percent, fit.model.target
    if reached > test.nonlinear_fit_percent - MISSED_PERCENT:
        return ""
    found = f", which reaches {reached:.3g} %"
    if test.term.startswith("y^"):
        found += (
            f"; a curve behind the dynamics is another kind: --structure oe, then correct --at "
            f"{target}"
        )
    return found


def _nonlinear(fits: Sequence[Fit]) -> list[str]:
    """Sentences on outputs that no linear model describes."""
    return [
        f"{fit.model.target}: nonlinear {_reached(fit, fit.linearity)}"
        for fit in fits
        if fit.linearity is not None and fit.linearity.matters and fit.model.is_linear
    ]


def _failed(fits: Sequence[Fit]) -> list[str]:
    """Sentences on models that predict nothing of the validation data."""
    sentences = []
    for fit in fits:
        held = fit.validation
        if held is None or held.predicts:
            continue
        sentence = (
            f"{fit.model.target}: the model predicts nothing: the mean of the validation data is "
            f"nearer to them than its run ({held.least_fit:.3g} %)"
        )
        if not held.is_split and held.estimated_state.fit_percent > 0:
            sentence = (
                f"{fit.model.target}: from rest, as simulate runs it, the model is farther from "
                f"the validation log than the mean of that ({held.least_fit:.3g} %); with the "
                f"state estimated there it has {held.estimated_state.fit_percent:.3g} %: the log "
                "may not begin at rest"
            )
        sentences.append(sentence)
    return sentences


def _empty(fits: Sequence[Fit]) -> list[str]:
    """Sentences on outputs of which no candidate predicts any rows that were held out."""
    found = []
    for k, fit in enumerate(fits):
        held = [each.fit_percent[k if k < len(each.fit_percent) else 0] for each in fit.candidates]
        held = [value for value in held if value == value]  # without NaN
        if fit.validation is None and held and max(held) <= 0:
            found.append(
                f"{fit.model.target}: the inputs say nothing of it: no candidate comes nearer to "
                f"rows held out than their mean (the best {max(held):.2g} %)"
            )
    return found


def document_warnings(fits: Sequence[Fit], model: Model) -> list[str]:
    """Sentences where the model document fits much worse, from rest, than the models do."""
    return lost_from_rest([
        (fit.model.target, fit.training, agreement_from_rest(model, fit.data)) for fit in fits
    ])  # fmt: skip
