"""The verdict on a model: adequate, not adequate, or not to be judged by these logs.

What `simulate` leaves of an output is noise, what the calibration itself was off by, what the
calibration leaves open (moves of its parameters within their covariance), or none of these. Only
the first two make a model adequate. What is none of these, and no cause of the catalogue, is a
cause of its own: `unknown`, told by where, when and how large it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermaltool.diagnosis.assumptions import STARTS
from thermaltool.diagnosis.evidence import DECISIVE_EVIDENCE
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.residual import ResidualReport
from thermaltool.diagnosis.residual_budget import (
    ADEQUATE_SHARE,
    OutputInLog,
    ResidualBudget,
    worst_logs,
)
from thermaltool.diagnosis.result import Cause, Location, Verdict
from thermaltool.diagnosis.severity import Severity
from thermaltool.effects.unknown import Unknown
from thermaltool.record import Record
from thermaltool.units import parse_channel, printed

# What is left beside named causes is told from this share of the RMS that was there before them.
MIN_SHARE_LEFT = 0.2
# Where responses together move an output less than so many times what one of them does, they are
# not told apart.
MAX_APART = 0.7
# A condition holds what is left where its share of the power exceeds that of the time by so much.
MIN_EXCESS = 0.15


def verdict_of(
    budgets: Mapping[OutputInLog, ResidualBudget], causes: Sequence[Cause], undecided: bool = False
) -> Verdict:
    """Verdict on a model.

    Parameters
    ----------
    budgets : mapping of (output, number of the log) to ResidualBudget
        Of the model as it came.
    causes : sequence of Cause
        The unknown one included.
    undecided : bool
        The search found that the logs cannot judge.
    """
    if undecided and not causes:
        return "cannot judge"
    if causes or any(each.wrong for each in budgets.values()):
        return "not adequate"
    if any(each.unsettled for each in budgets.values()):
        return "cannot judge"
    return "adequate"


def undecided(
    hypothesis: Hypothesis, budgets: Mapping[OutputInLog, ResidualBudget]
) -> tuple[str, ...]:
    """Why logs cannot judge a model, and what would help, a sentence an output.

    Parameters
    ----------
    hypothesis : Hypothesis
        Without any cause.
    budgets : mapping of (output, number of the log) to ResidualBudget
        Of the model as it came.
    """
    found = []
    for output, at in worst_logs(budgets).items():
        each, log = budgets[at], hypothesis.logs[at[1]]
        here = f"in {log.name}" if len(hypothesis.logs) > 1 and log.name else "in this log"
        unit = printed(parse_channel(output).unit)
        if _only_left_open(each):
            found.append(
                f"{output}: the calibration leaves open {_most_open(hypothesis, at)}, which "
                f"makes {np.sqrt(each.shown**2 - each.unexplained**2):.3g} {unit} {here}: "
                "calibrate on such a log of a machine that is sound, beside the calibration's own"
            )
        elif each.too_large and not each.wrong:
            found.append(
                f"{output}: {each.unexplained:.3g} {unit} RMS is left, so slow that these logs say "
                "it about once: it may be chance. Diagnose a longer log, or several"
            )
        elif each.coarse or each.allowed < ADEQUATE_SHARE:
            found.append(
                f"{output}: the calibration itself is off by {each.calibrated:.3g} {unit}, "
                f"{each.calibrated / each.white:.0f} times the noise of a reading: calibrate with "
                "another response, a further drive or a longer log"
            )
        elif each.more_than_clean:
            found.append(
                f"{output}: {each.unexplained:.3g} {unit} RMS is left beside what the calibration "
                f"leaves open, where a clean log has {each.clean:.2g} {unit}: diagnose another log"
            )
    return tuple(found)


def _only_left_open(budget: ResidualBudget) -> bool:
    """Whether a residual is explained, but only by what the calibration leaves open."""
    return budget.allowed >= ADEQUATE_SHARE > budget.accounted


def nothing_moves(
    hypothesis: Hypothesis, budgets: Mapping[OutputInLog, ResidualBudget]
) -> str | None:
    """Why logs in which the machine rests cannot judge a model; None where it moves.

    It rests where a model without any response would not be told from this one, and no output moves
    by what the calibration leaves open.

    Parameters
    ----------
    hypothesis : Hypothesis
        Without any cause.
    budgets : mapping of (output, number of the log) to ResidualBudget
        Of the model as it came.
    """
    if any(map(_only_left_open, budgets.values())):
        return None
    visible = 0.0
    for output, groups in hypothesis.groups.items():
        # The zero of each log is free, and a steady state is a start against which no drive moves.
        begun = zip(hypothesis.simulation.outputs, hypothesis.beginning(output), strict=True)
        moved = [
            y - np.mean(y[rows]) if len(rows) else y
            for y, rows in zip((y[output] + start for y, start in begun), groups.rows, strict=True)
        ]
        joined = groups.joined(moved) / hypothesis.white(output)
        visible += float(np.sum(np.square(joined)))
        starts = hypothesis.nuisance[output].starts
        fitted = sum(len(starts[way]) for way in STARTS & hypothesis.assumptions)
        visible -= fitted * float(np.log(max(len(joined), 1)))
    # As the fall of BIC by a response, without its price; a start that is fitted has its own.
    if visible > DECISIVE_EVIDENCE:
        return None
    drives = ", ".join(drive.channel for drive in hypothesis.model.drives)
    return (
        f"no output would move by what {drives} does in these logs: diagnose logs in which the "
        "machine is driven"
    )


def _most_open(hypothesis: Hypothesis, at: OutputInLog) -> str:
    """What the calibration leaves open that explains most of an output in a log."""
    output, k = at
    nuisance, rows = hypothesis.nuisance[output], hypothesis.groups[output].rows[k]
    fitted = hypothesis.evidence[output].fitted(hypothesis.assumptions, nuisance.group)
    changes = nuisance.moves[k][rows] * (nuisance.prior.root @ fitted)
    drives = list(dict.fromkeys(nuisance.moving))
    own = [changes[:, [each == d for each in nuisance.moving]].sum(axis=1) for d in drives]
    order = np.argsort([-float(np.std(each)) for each in own])
    first, *rest = (drives[k] for k in order)
    # What one response gains the other loses: together they are known better than each alone.
    if rest and np.std(changes.sum(axis=1)) < MAX_APART * np.std(own[order[0]]):
        return f"how much of it {first} and {rest[0]} move each"
    return f"the response to {first}"


def unknown_cause(
    budgets: Mapping[OutputInLog, ResidualBudget],
    before: Mapping[OutputInLog, ResidualBudget],
    reports: Mapping[OutputInLog, ResidualReport],
    hypothesis: Hypothesis,
    named: bool,
) -> Cause | None:
    """What is left beside all named causes, where it is not noise; None where it is.

    Parameters
    ----------
    budgets, before : mapping of (output, number of the log) to ResidualBudget
        Of the model with the named causes, and as it came.
    reports : mapping of (output, number of the log) to ResidualReport
        Of what is left.
    hypothesis : Hypothesis
        With the named causes.
    named : bool
        Whether there are any.
    """
    worst = {
        at: each
        for at, each in budgets.items()
        # Of a model that is not adequate something is wrong, be it too slow to be decisive.
        if each.wrong
        and (
            not named
            or (
                each.evidence >= DECISIVE_EVIDENCE
                and each.total > MIN_SHARE_LEFT * before[at].total
            )
        )
    }
    if not worst:
        return None
    at = max(worst, key=lambda each: worst[each].unexplained / worst[each].white)
    output, rms = at[0], worst[at].unexplained
    where = _location(hypothesis.logs[at[1]], output, reports[at])
    stretch = reports[at].worst
    return Cause(
        Unknown(output, {"rms": rms}),
        worst[at].evidence,
        {},
        {},
        0.0,
        location=where,
        severity={output: Severity(where.rms if stretch is None else stretch.rms, where.rms)},
    )


def _location(log: Record, output: str, report: ResidualReport) -> Location:
    """Where most of a residual is."""
    worst = report.worst
    conditions = [c for c in report.conditions if c.power - c.time > MIN_EXCESS]
    condition = max(conditions, key=lambda c: c.power - c.time, default=None)
    name = None
    if condition is not None:
        name = (
            condition.name if condition.channel is None else f"{condition.channel} {condition.name}"
        )
    band = max(report.bands, key=lambda b: b.power, default=None)
    return Location(
        log.digest,
        output,
        0.0 if worst is None else worst.start,
        float(log.elapsed[-1]) if worst is None else worst.stop,
        name,
        None if band is None else band.shortest,
        None if band is None else band.longest,
        report.spread if report.rms is None else report.rms,
    )
