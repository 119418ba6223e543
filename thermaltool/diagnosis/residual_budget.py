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
from thermaltool.diagnosis.simulation import Series
from thermaltool.fitting.averaging import Averages, known_noise
from thermaltool.fitting.discrepancy import DRIFT_RATIOS, MAX_OVER_NOISE, calibration_error
from thermaltool.model import Model
from thermaltool.signals.detrend import difference_sigma
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
# Below this fall of BIC nothing is worth more than a bare mention, from the second on it is strong
# (Kass & Raftery 1995).
MIN_EVIDENCE, STRONG_EVIDENCE = 2.0, 6.0
# Output and number of a log.
OutputInLog = tuple[str, int]
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
        """Whether what the model leaves is no noise, and its calibration no measure of it."""
        noise = self.white**2 >= ADEQUATE_SHARE * self.total**2
        return not noise and self.calibrated > MAX_OVER_NOISE * self.white

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
    def unsettled(self) -> bool:
        """Whether it is more than noise and what the calibration has shown."""
        largely = min(self.allowed, self.accounted) < ADEQUATE_SHARE
        return largely or self.coarse or self.more_than_clean

    @property
    def more_than_clean(self) -> bool:
        """Whether more is left than a clean log has, be it the smaller part of the residual."""
        return not self.usual and self.evidence >= STRONG_EVIDENCE

    @property
    def severity(self) -> tuple[bool, bool, float, float]:
        """By which several logs are compared: the larger, the worse."""
        return self.wrong, self.unsettled, self.evidence, self.shown

    @property
    def evidence(self) -> float:
        """Fall of BIC from what a clean log may have to what is there, of its independent rows."""
        ratio = self.unexplained**2 / max(self.clean**2, TINY)
        if ratio <= 1:
            return 0.0
        return self.rows * (ratio - 1 - float(np.log(ratio))) - float(np.log(max(self.rows, 1.0)))

    @property
    def clean(self) -> float:
        """What a clean log has: noise and its floor."""
        return float(np.hypot(self.white, self.floor))

    def _above(self, rms: float) -> float:
        power = rms**2 - self.clean**2
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


@dataclass(frozen=True)
class OutputResiduals:
    """What is left of an output in every log, each of shape (n_log,) [unit of the output].

    Attributes
    ----------
    plain : list of ndarray
        Beside the start of each log.
    starts : list of ndarray
        What is left of an unknown state at the first row; zero where a log begins at rest.
    shown : list of ndarray
        Beside the start and the error of shape that the calibration has shown.
    unexplained : list of ndarray
        Beside the moves that the calibration leaves open, too.
    """

    plain: Series
    starts: Series
    shown: Series
    unexplained: Series

    @staticmethod
    def of(hypothesis: Hypothesis, plain: Hypothesis, output: str) -> OutputResiduals:
        """Of a model.

        Parameters
        ----------
        hypothesis : Hypothesis
            What the model may say for itself.
        plain : Hypothesis
            The model as a user simulates it.
        output : str
        """
        starts = _starts(plain, output)
        residual = plain.simulation.residual(output)
        # Where its own parameters are free nothing of a model is open, but when commands switch is.
        own = "tight" not in hypothesis.assumptions
        judged = plain if own else hypothesis
        of_logs = judged.of_logs(output)
        shown = [r - x for r, x in zip(judged.simulation.residual(output), of_logs, strict=True)]
        return OutputResiduals(
            [r - x for r, x in zip(residual, starts, strict=True)],
            starts,
            shown,
            shown if own else hypothesis.unexplained(output),
        )


def _starts(plain: Hypothesis, output: str) -> Series:
    """What each log brings along as `simulate` has it, or the logs say, whichever leaves less."""
    runs, found = plain.simulation, []
    for k, (residual, start) in enumerate(
        zip(runs.residual(output), plain.beginning(output), strict=True)
    ):
        each = [start]
        if output in runs.started[k]:
            each.append(runs.started[k][output].computed - runs.outputs[k][output])
        rows = plain.groups[output].rows[k]
        left = [float(np.var((residual - x)[rows])) if len(rows) else 0.0 for x in each]
        found.append(each[int(np.argmin(left))])
    return found


def budget_of(
    hypothesis: Hypothesis,
    plain: Hypothesis,
    at: OutputInLog,
    left: OutputResiduals,
    white: float,
    rows: float,
) -> ResidualBudget:
    """Where the residual of an output goes in one log.

    Parameters
    ----------
    hypothesis, plain : Hypothesis
        As in `OutputResiduals.of`.
    at : tuple of (output, number of the log)
    left : OutputResiduals
    white : float [unit of the output]
        Noise of a reading.
    rows : float
        Independent rows.
    """
    output, k = at
    counted, own = hypothesis.groups[output].rows[k], "tight" not in hypothesis.assumptions
    hidden = hidden_in(hypothesis.logs[k], output)

    def rms(series: Series) -> float:
        return float(np.sqrt(np.var(series[k][counted]) + hidden**2))

    total = rms(left.plain)
    fit = next(o.fit for o in plain.model.outputs if o.channel == output)
    return ResidualBudget(
        total,
        min(total, rms(left.shown)),
        min(total, rms(left.unexplained)),
        white,
        floor_of(hypothesis, output),
        0.0 if own else calibration_error(fit),
        0.0 if own else misfit_of(plain.model, output),
        rows,
    )


def _report_of(
    hypothesis: Hypothesis, at: OutputInLog, left: OutputResiduals, white: float
) -> ResidualReport:
    """An output's residual in one log."""
    output, k = at
    log = hypothesis.logs[k]
    warm = bool(np.any(left.starts[k]))
    report = residual_report(
        log.elapsed,
        left.plain[k],
        hypothesis.simulation.measured[k][output],
        {d.channel: log.columns[d.channel] for d in hypothesis.model.drives},
        {c: v for c, v in log.columns.items() if c in hypothesis.scene.extra},
        white,
        hidden_in(log, output),
        warm,
    )
    report = replace(report, log=log.digest)
    return replace(report, rms=None, mean=None) if warm else report


def weigh_residuals(
    hypothesis: Hypothesis, plain: Hypothesis, noise: Mapping[str, float]
) -> tuple[dict[OutputInLog, ResidualReport], dict[OutputInLog, ResidualBudget]]:
    """Residual of every output in every log that has enough of its rows, and where it goes.

    Parameters
    ----------
    hypothesis, plain : Hypothesis
        As in `OutputResiduals.of`.
    noise : mapping of output to float [unit of the output]
        Of a reading, over all logs; one that is noisier has its own.
    """
    reports, budgets = {}, {}
    for output, groups in hypothesis.groups.items():
        counts = [len(rows) for rows in groups.rows]
        left = OutputResiduals.of(hypothesis, plain, output)
        # One that has most is there at least, and tells what is missing.
        least = min(MIN_ROWS, max(counts))
        for k in (k for k, count in enumerate(counts) if count >= least):
            at = output, k
            white = max(noise[output], _noise_in(hypothesis, at, left))
            report = _report_of(hypothesis, at, left, white)
            budget = budget_of(hypothesis, plain, at, left, white, report.effective_rows)
            reports[at] = replace(report, parts=budget.parts)
            budgets[at] = budget
    return reports, budgets


def _noise_in(hypothesis: Hypothesis, at: OutputInLog, left: OutputResiduals) -> float:
    """White noise of a reading in one of several logs; 0 where it is the only one."""
    output, k = at
    log = hypothesis.logs[k]
    if len(hypothesis.logs) == 1:
        return 0.0
    if isinstance(log, Averages):
        return log.noise.get(output, 0.0)
    rows = hypothesis.groups[output].rows[k]
    step = resolution_step(log.columns[output]) or 0.0
    return max(difference_sigma(left.plain[k][rows]), step / float(np.sqrt(12.0)))


def worst_logs(budgets: Mapping[OutputInLog, ResidualBudget]) -> dict[str, OutputInLog]:
    """The log of each output in which a model is worst.

    Parameters
    ----------
    budgets : mapping of (output, number of the log) to ResidualBudget
    """
    found: dict[str, OutputInLog] = {}
    for at, budget in budgets.items():
        before = found.get(at[0])
        if before is None or budget.severity > budgets[before].severity:
            found[at[0]] = at
    return found
