"""Noise that depends on a state: a drive, a pump or a lamp is heard in a sensor's line."""

from __future__ import annotations

from typing import ClassVar

from thermaltool.effects.effect import Effect, Parameter, Side


class NoiseState(Effect):
    """No physics, and no part of a model: readings have noise `loud` while `partner` acts.

    Else it is `quiet`, both as standard deviations from one reading to the next. Without a
    `partner` they are `loud` throughout, and were `quiet` at the calibration.
    """

    name: ClassVar[str] = "noise_state"
    side: ClassVar[Side] = "sensor"
    explanation: ClassVar[str] = (
        "a sensor is noisier in one operating state, or than at the calibration: an inverter, a "
        "pump or a brush is heard in its line, or a contact is loose"
    )
    action: ClassVar[str] = (
        "look at shield, ground and filter of {channel}: its noise is {loud} while {partner} "
        "acts, and {quiet} else"
    )
    action_alone: ClassVar[str] = (
        "look at contacts, shield, ground and filter of {channel}: its noise is {loud}, and was "
        "{quiet} at the calibration"
    )
    signature: ClassVar[str] = (
        "scatter from one reading to the next that follows a state of the log, or is several times "
        "what it was at the calibration"
    )
    source: ClassVar[str] = "Ott 2009, ch. 2 (noise coupled into cables)"
    causal: ClassVar[bool] = True
    known: ClassVar = {
        "quiet": Parameter("{channel}", low=0.0, fixed=True),
        "loud": Parameter("{channel}", low=0.0, fixed=True),
    }
