"""What ``regularize`` reports: the trade-off of every form, and what was chosen."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from thermaltool.estimation.design import EstimatorDesign
from thermaltool.estimation.regularization import DesignChoice, best_choice
from thermaltool.report.text import aligned

# The setting by which the choices of a form differ.
SETTINGS = {"kalman": "walk_per_sqrt_s", "kernel": "delay_s"}


def design_table(design: EstimatorDesign) -> str:
    """Every choice with its lag, and with band and noise of each deflection."""
    heading = ["form", "setting", "lag s", "settles s"]
    heading += [f"{name}: rmse" for name in design.problem.drives]
    for name in design.problem.outputs:
        heading += [f"{name}: band", "lag error", "noise σ"]
    rows = [heading]
    for form, choices in design.choices.items():
        for choice in choices:
            mark = " <" if choice is design.best else ""
            predicted, setting = choice.prediction, SETTINGS[form]
            row = [form, f"{setting} {choice.settings[setting]:.3g}{mark}"]
            row += [f"{predicted.lag:.1f}", f"{predicted.settling:.0f}"]
            row += [f"{error:.3g}" for error in predicted.heat_rmse]
            for k in range(len(design.problem.outputs)):
                found = predicted.band[k], predicted.lag_error[k], predicted.noise_sigma[k]
                row += [f"{value:.3g}" for value in found]
            rows.append(row)
    return aligned(rows)


def design_summary(design: EstimatorDesign) -> str:
    """One line: the form that was chosen, with its settings or with what it reads."""
    if design.best is None:
        read = design.model.estimator_design()["known"]["columns"]
        # A channel that drives and schedules is read twice.
        channels = dict.fromkeys(each["channel"] for each in read)
        return f"chosen: feedforward, from {', '.join(channels)}"
    settings = (f"{name} = {value:.4g}" for name, value in design.best.settings.items())
    return f"chosen: {design.chosen}, {', '.join(settings)}"


def design_document(design: EstimatorDesign) -> dict[str, Any]:
    """The whole trade-off as JSON."""
    return {
        "chosen": design.chosen,
        "outputs": list(design.problem.outputs),
        "sample_period_s": design.problem.dt,
        "forms": {
            form: {
                **_choice(best_choice(choices)),
                "trade_off": [_choice(choice) for choice in choices],
            }
            for form, choices in design.choices.items()
        },
    }


def _choice(choice: DesignChoice) -> dict[str, Any]:
    return {"settings": choice.settings, "predicted": asdict(choice.prediction)}
