"""Where an output's residual in a log goes: noise, what the calibration left, or leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermaltool.diagnosis.correction import known_discrepancy
from thermaltool.diagnosis.hypothesis import Hypothesis
from thermaltool.diagnosis.readings import hidden_in
from thermaltool.diagnosis.residual import MIN_ROWS, ResidualReport, residual_report
from thermaltool.diagnosis.residual_parts import ResidualParts
from thermaltool.effects.effect import Float
from thermaltool.fitting.averaging import known_noise
from thermaltool.fitting.discrepancy import DRIFT_RATIOS, MAX_OVER_NOISE, calibration_error
from thermaltool.model import Model
from thermaltool.signals.resolution import resolution_step

# The discrepancy of a clean log, of other inputs than the calibration's, is taken to be no larger
# than this many times its floor.
MAX_FLOORS = 2.0
# Share of the residual's power that noise and floor must account for in an adequate model.
ADEQUATE_SHARE = 0.5
# On other inputs than those of its calibration a model is off by no more than this many times what
# it was off by there, beside the noise of a reading: no cause and no unknown is called below. Of a
# misfit that a diagnosis knows from the calibration this many times what it does not know counts.
# Where it is lost in the noise nothing of it counts, from the second share of the noise on all.
MAX_TIMES_CALIBRATED, MAX_DRIFTS, OVER_NOISE = 3.5, 2.0, (0.5, 2.0)
# Below this fall of BIC nothing is worth more than a bare mention (Kass & Raftery 1995).
MIN_EVIDENCE = 2.0
# Output and number of a log.
Place = tuple[str, int]
# Power that stands for none [unit of the output, squared].
TINY = 1e-300


@dataclass(frozen=True)
class ResidualBudget:
    """Where the residual of an output in one log goes, as RMS about its mean.

    Attributes
    ----------
    total : float [unit of the output]
        What the model leaves; a start away from rest is fitted apart.
    shown : float
        What is left of it beside the error of shape that the calibration has shown.
    unexplained : float
        What is left beside the moves that the calibration leaves open, too.
    white, floor : float
        Noise of a reading, and the largest slow discrepancy of a clean log.
    calibrated, misfit : float
        What the model left of its own calibration, with noise and without (`misfit_of`).
    rows : float
        Independent rows.
    """

    total: float
    shown: float
    unexplained: float
    white: float
    floor: float
    calibrated: float
    misfit: float
    rows: float

    @property
    def accounted(self) -> float:
        """Share of the power that noise and what the calibration has shown account for."""
        return 1.0 - self._above(self.shown)

    @property
    def parts(self) -> ResidualParts:
        """What of it is noise, what the calibration left, and what is neither."""
        return ResidualParts.of(self.total, self.white, self.accounted)

    @property
    def allowed(self) -> float:
        """Share of the power that these and what the calibration leaves open account for."""
        return 1.0 - self._above(self.unexplained)

    @property
    def coarse(self) -> bool:
        """Whether the calibration itself is too far off to judge anything by it."""
        least = MAX_OVER_NOISE * self.white
        return self.calibrated > least and self.total > least

    @property
    def usual(self) -> bool:
        """Whether what is unexplained may be what the calibration itself is off by."""
        return self.unexplained**2 - self.white**2 <= (MAX_TIMES_CALIBRATED * self.misfit) ** 2

    @property
    def too_large(self) -> bool:
        """Whether more is left than noise, and than what the calibration shows and leaves open."""
        return self.allowed < ADEQUATE_SHARE and not self.usual

    @property
    def wrong(self) -> bool:
        """Whether it is too large, and these rows are enough to say so."""
        return self.too_large and self.evidence >= MIN_EVIDENCE

    @property
    def open(self) -> bool:
        """Whether it is more than noise and what the calibration has shown."""
        return min(self.allowed, self.accounted) < ADEQUATE_SHARE or self.coarse

    @property
    def order(self) -> tuple[bool, bool, float, float]:
        """By which several logs are compared: the larger, the worse."""
        return self.wrong, self.open, self.evidence, self.shown

    @property
    def evidence(self) -> float:
        """Fall of BIC from what a clean log may have to what is there, of its independent rows."""
        ratio = self.unexplained**2 / max(self.white**2 + self.floor**2, TINY)
        if ratio <= 1:
            return 0.0
        return self.rows * (ratio - 1 - float(np.log(ratio))) - float(np.log(max(self.rows, 1.0)))

    def _above(self, rms: float) -> float:
        power = rms**2 - self.white**2 - self.floor**2
        return float(np.clip(power / self.total**2, 0.0, 1.0)) if self.total else 0.0


def misfit_of(model: Model, output: str) -> float:
    """What a model left of its calibration beside the noise of a reading [unit of the output].

    Zero where the calibration came near the noise, or where nothing is known of it.

    Parameters
    ----------
    model : Model
    output : str
    """
    fit = next(o.fit for o in model.outputs if o.channel == output)
    known = known_discrepancy(model, output)
    if not known or "rmse" not in fit:
        return 0.0
    white = float(known["white_sigma"])
    left = calibration_error(fit)
    misfit = float(np.sqrt(max(left**2 - white**2, 0.0)))
    drift = float(known["drift_sigma"])
    # A misfit that is larger than any drift that was tried is that of the kind of response.
    if drift < 0.99 * float(np.sqrt(max(DRIFT_RATIOS))) * white:
        misfit = min(misfit, MAX_DRIFTS * drift)
    if white <= 0:
        return misfit
    lost, sure = (share * white for share in OVER_NOISE)
    return misfit * float(np.clip((misfit - lost) / (sure - lost), 0.0, 1.0))


def reading_noise(hypothesis: Hypothesis, output: str) -> float:
    """White noise of a reading, blind to misfit and outliers; a quantizer's at least.

    Parameters
    ----------
    hypothesis : Hypothesis
    output : str
    """
    known = known_noise(hypothesis.logs, output)
    if known is not None:
        return known
    readings = [log.columns[output] for log in hypothesis.logs if output in log.columns]
    step = resolution_step(np.concatenate(readings)) or 0.0
    return max(hypothesis.nuisance[output].white, step / float(np.sqrt(12.0)))


def floor_of(hypothesis: Hypothesis, output: str) -> float:
    """Largest discrepancy of a clean log [unit of the output]; 0 where nothing is known of it.

    Parameters
    ----------
    hypothesis : Hypothesis
    output : str
    """
    if "tight" not in hypothesis.assumptions:
        return 0.0
    slow = MAX_FLOORS * hypothesis.nuisance[output].floor()
    return max(slow, misfit_of(hypothesis.model, output))


def start_of(plain: Hypothesis, place: Place) -> Float:
    """What is left of an unknown state at the first row of a log; zero where it begins at rest.

    As `simulate` has it, or as these logs together say, whichever leaves less.

    Parameters
    ----------
    plain : Hypothesis
        The model as a user simulates it.
    place : tuple of (output, number of the log)
    """
    output, k = place
    runs, rows = plain.simulation, plain.groups[output].rows[k]
    starts = [plain.beginning(output)[k]]
    if output in runs.started[k]:
        starts.append(runs.started[k][output].computed - runs.outputs[k][output])
    residual = runs.residual(output)[k]
    return min(starts, key=lambda start: float(np.var((residual - start)[rows])))


def budget_of(
    hypothesis: Hypothesis, plain: Hypothesis, place: Place, white: float, rows: float
) -> ResidualBudget:
    """Where the residual of an output goes in one log.

    Parameters
    ----------
    hypothesis : Hypothesis
        What the model may say for itself.
    plain : Hypothesis
        The model as a user simulates it.
    place : tuple of (output, number of the log)
    white : float [unit of the output]
        Noise of a reading.
    rows : float
        Independent rows.
    """
    output, k = place
    counted = hypothesis.groups[output].rows[k]
    own = "tight" not in hypothesis.assumptions
    hidden = hidden_in(hypothesis.logs[k], output)

    def rms(left: Float) -> float:
        return float(np.sqrt(np.var(left[counted]) + hidden**2))

    total = rms(plain.simulation.residual(output)[k] - start_of(plain, place))
    # Where its own parameters are free nothing of a model is open, but when commands switch is.
    judged = plain if own else hypothesis
    shown = min(total, rms(judged.simulation.residual(output)[k] - judged.of_logs(output)[k]))
    fit = next(o.fit for o in plain.model.outputs if o.channel == output)
    return ResidualBudget(
        total,
        shown,
        shown if own else min(total, rms(hypothesis.unexplained(output)[k])),
        white,
        floor_of(hypothesis, output),
        0.0 if own else calibration_error(fit),
        0.0 if own else misfit_of(plain.model, output),
        rows,
    )  # fmt: skip


def report_of(
    hypothesis: Hypothesis, plain: Hypothesis, place: Place, white: float
) -> ResidualReport:
    """An output's residual in one log.

    Parameters
    ----------
    hypothesis : Hypothesis
        What the model may say for itself: its start in each log.
    plain : Hypothesis
        The model as a user simulates it.
    place : tuple of (output, number of the log)
    white : float [unit of the output]
        Noise of a reading.
    """
    output, k = place
    start, log = start_of(plain, place), hypothesis.logs[k]
    report = residual_report(
        log.elapsed,
        plain.simulation.residual(output)[k] - start,
        hypothesis.simulation.measured[k][output],
        {d.channel: log.columns[d.channel] for d in hypothesis.model.drives},
        {c: v for c, v in log.columns.items() if c in hypothesis.scene.extra},
        white,
        hidden_in(log, output),
    )
    report = replace(report, log=log.digest)
    return replace(report, rms=None, mean=None) if np.any(start) else report


def weigh_residuals(
    hypothesis: Hypothesis, plain: Hypothesis, noise: Mapping[str, float]
) -> tuple[dict[Place, ResidualReport], dict[Place, ResidualBudget]]:
    """Residual of every output in every log that has enough of its rows, and where it goes.

    Parameters
    ----------
    hypothesis, plain : Hypothesis
        As in `budget_of`.
    noise : mapping of output to float [unit of the output]
        Of a reading.
    """
    reports, budgets = {}, {}
    for output, groups in hypothesis.groups.items():
        counts = [len(rows) for rows in groups.rows]
        # One that has most is there at least, and tells what is missing.
        least = min(MIN_ROWS, max(counts))
        for k in (k for k, count in enumerate(counts) if count >= least):
            place = output, k
            report = report_of(hypothesis, plain, place, noise[output])
            budget = budget_of(hypothesis, plain, place, noise[output], report.effective_rows)
            reports[place] = replace(report, parts=budget.parts)
            budgets[place] = budget
    return reports, budgets


def worst_places(budgets: Mapping[Place, ResidualBudget]) -> dict[str, Place]:
    """The log of each output in which a model is worst.

    Parameters
    ----------
    budgets : mapping of (output, number of the log) to ResidualBudget
    """
    found: dict[str, Place] = {}
    for place, budget in budgets.items():
        before = found.get(place[0])
        if before is None or budget.order > budgets[before].order:
            found[place[0]] = place
    return found
