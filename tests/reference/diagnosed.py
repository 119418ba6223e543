"""A diagnosis whose answer is known: a lamp's heat, and a bed that the model does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermaltool.diagnosis.action import action_of
from thermaltool.diagnosis.gain import Gain
from thermaltool.diagnosis.residual import residual_report
from thermaltool.diagnosis.residual_parts import ResidualParts
from thermaltool.diagnosis.result import Alternative, Cause, Diagnosis, Tried, Verdict
from thermaltool.diagnosis.severity import Severity
from thermaltool.diagnosis.written import WrittenStep
from thermaltool.effects.second_source import SecondSource
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection
from thermaltool.signals.agreement import Agreement

OUTPUT, DRIVE, BED = "d_z_um", "Q_main_1", "T_bed_degC"
WHITE = 0.5
MODEL = Model(
    drives=(Drive(DRIVE, "zero", 0.0, (0.0, 1.0)),),
    outputs=(Output(OUTPUT, "deflection", "first", (0.0, 90.0), {"rmse": 1.1}),),
    terms=(Term(DRIVE, OUTPUT, Deflection(A=50.0, a=0.002, B=20.0, b=5e-4, D=-0.01, d=0.001)),),
    sample_period=10.0,
)
UNDECIDED = (
    "d_z_um: the calibration leaves open the response to Q_main_1, which makes 3 µm in this log"
)
BEFORE = Agreement(20.0, 40.0, 12.0, 60.0, 1.0, 71.0, 2160)
AFTER = Agreement(10.0, 12.0, 8.0, 20.0, 1.0, 91.0, 2160)
SOURCE = SecondSource(BED, {f"gain[{OUTPUT}]": 0.6, "time_constant": 840.0})


def measured(seed: int = 4, bed: float = 60.0) -> Record:
    """Six hours: the lamp for three, the bed (to `bed` degC) from the fourth on."""
    time = 10.0 * np.arange(2160)
    columns = {
        DRIVE: np.where(time < 10800, 1.0, 0.0),
        BED: 20.0 + (bed - 20.0) * -np.expm1(-np.maximum(time - 10800, 0) / 300),
    }
    clean = Record(time, columns)
    bent = SOURCE.output(OUTPUT, MODEL.simulate(Record(time, columns)), clean)
    noise = WHITE * np.random.default_rng(seed).standard_normal(len(time))
    return Record(time, {**columns, OUTPUT: bent + noise}, digest=f"digest-{seed}")


def diagnosed(
    logs: Sequence[Record], causes: int = 1, verdict: Verdict = "not adequate"
) -> Diagnosis:
    """What a diagnosis of `logs` should say."""
    log = logs[0]
    y = log.columns[OUTPUT] - log.columns[OUTPUT][0]
    plain = MODEL.simulate(log)
    extended = SOURCE.output(OUTPUT, plain, log)
    report = residual_report(
        log.time, y - plain[OUTPUT], y, {DRIVE: log.columns[DRIVE]}, {BED: log.columns[BED]},
        WHITE,
    )  # fmt: skip
    known = 0.9 if verdict == "adequate" else 0.12
    report = replace(report, parts=ResidualParts.of(report.spread, WHITE, known))
    gain = Gain(16.4, 6.1, 40.0, 12.0, 71.0, 91.0, (9.1, 11.3))
    held_out = replace(gain, rms_before=18.0, rms_after=7.0)
    intervals = {f"gain[{OUTPUT}]": (0.59, 0.63), "time_constant": (800.0, 880.0)}
    severity = {OUTPUT: Severity(24.0, 15.0)}
    cause = Cause(
        SOURCE, 552.0, intervals, {OUTPUT: gain}, 0.9, {OUTPUT: held_out},
        severity=severity, action=action_of(SOURCE, severity, {OUTPUT: WHITE}),
    )  # fmt: skip
    other = Alternative(
        ("second_source", "ambient_drift"), (BED, ""), 4.0, "the bed alone, lamp off, for 2 h", 60.0
    )
    tried = (
        Tried("second_source", BED, 552.0, 0.3, "accepted", OUTPUT),
        Tried("ambient_drift", "", 119.0, 0.4, "explained by another", OUTPUT),
        Tried("transport_delay", DRIVE, -7.1, None, "cannot be seen"),
    )
    curves = {"measured": y, "simulated": plain[OUTPUT]}
    if causes:
        curves["extended"] = extended
    found = Diagnosis(
        verdict=verdict,
        noise_share=known,
        residuals={OUTPUT: report},
        causes=(cause,) * causes,
        alternatives=(other,) if causes else (),
        tried=tried,
        notes=(),
        model=MODEL,
        extends=bool(causes),
        undecided=(UNDECIDED,) if verdict == "cannot judge" else (),
        written=tuple(
            WrittenStep(k, SOURCE if k else None, each.digest, OUTPUT, fit)
            for k, fit in enumerate([BEFORE, AFTER][: 1 + causes])
            for each in logs
        ),
        curves=((OUTPUT, replace(log, columns=curves)),),
    )
    return found
