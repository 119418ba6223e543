"""Record too short: the calibration never saw the slowest part of the machine settle."""

from __future__ import annotations

from typing import ClassVar

from thermaltool.effects.effect import Effect, Parameter, Side


class RecordTooShort(Effect):
    """No physics: what the model says of long times was never calibrated.

    It is found by comparing the length of a record with the slowest time constant, not by a trial.
    """

    name: ClassVar[str] = "record_too_short"
    side: ClassVar[Side] = "structure"
    explanation: ClassVar[str] = (
        "the record ends before the slowest part of the machine has settled, so its time constant "
        "and steady state are guessed"
    )
    action: ClassVar[str] = (
        "calibrate again on a log that lasts until the slowest part has settled: three of "
        "its slowest time constants, where this calibration has {covered}"
    )
    signature: ClassVar[str] = (
        "the residual grows with the time since a change of the drive, beyond what was calibrated"
    )
    source: ClassVar[str] = "Ljung 1999, ch. 13 (experiment design)"
    causal: ClassVar[bool] = True
    known: ClassVar = {"covered": Parameter("1", neutral=1.0, low=0.0, fixed=True)}
