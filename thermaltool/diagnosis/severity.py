"""How much a cause moves each output over the logs, and the tolerance that this is held against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermaltool.diagnosis.simulation import Mask, SimulatedLogs, without
from thermaltool.diagnosis.written import explained, gains_of
from thermaltool.effects.effect import Effect
from thermaltool.errors import UnitError
from thermaltool.model import Model
from thermaltool.record import Record, hint
from thermaltool.units import converted, parse_channel, parse_quantity


@dataclass(frozen=True)
class Severity:
    """What a cause does to an output.

    Attributes
    ----------
    largest, rms : float [unit of the output]
        Largest change in any row of the logs, and its RMS over the logs in which it acts. Of an
        unknown cause: the RMS where it is worst, and over its log.
    """

    largest: float
    rms: float

    def document(self, tolerance: float | None) -> dict[str, Any]:
        """As JSON, beside a tolerance.

        Parameters
        ----------
        tolerance : float or None [unit of the output]
        """
        times = None if tolerance is None else self.largest / tolerance
        return {
            "largest": self.largest,
            "rms": self.rms,
            "tolerance": tolerance,
            "times_tolerance": times,
        }


def severity_of(model: Model, effect: Effect, logs: Sequence[Record]) -> dict[str, Severity]:
    """What a cause moves in the model as it is written, with all other causes in it.

    Parameters
    ----------
    model : Model
        With all causes.
    effect : Effect
        One of them.
    logs : sequence of Record

    Returns
    -------
    dict of output to Severity
        Of the outputs that it moves.
    """
    rest = without(model, effect)
    acting = tuple(log for log in logs if effect.log in (None, log.digest))
    if rest is model or not acting:
        return {}
    caused, bare = (SimulatedLogs(each, acting, {}) for each in (model, rest))
    found = {}
    for output, series in bare.change(caused.outputs).items():
        change = np.concatenate(series)
        found[output] = Severity(float(np.max(np.abs(change))), float(np.sqrt(np.mean(change**2))))
    return found


def moves(model: Model, effect: Effect, log: Record, noise: Mapping[str, float]) -> bool:
    """Whether a cause moves any output of a log by the noise of a reading at least.

    A limit that no command reaches does not.

    Parameters
    ----------
    model : Model
        With all causes.
    effect : Effect
        One of them.
    log : Record
    noise : mapping of output to float [unit of the output]
        Of a reading.
    """
    moved = severity_of(model, effect, [log])
    return any(moved[o].largest >= noise[o] for o in moved.keys() & noise.keys())


def fraction_removed(
    model: Model,
    effect: Effect,
    logs: Sequence[Record],
    masked: Mask,
    noise: Mapping[str, float],
    from_rest: bool,
) -> float:
    """Share of the misfit above noise that comes back where a cause alone is left out.

    Parameters
    ----------
    model : Model
        With all causes.
    effect : Effect
        One of them.
    logs : sequence of Record
    masked : mapping of (digest, output) to ndarray of bool, shape (rows of the log,)
        Outliers: rows that do not count.
    noise : mapping of output to float [unit of the output]
        Of a reading.
    from_rest : bool
        All logs begin at rest; else what a start leaves does not count where one begins warm.
    """
    runs = [SimulatedLogs(each, tuple(logs), masked) for each in (without(model, effect), model)]
    warm = set() if from_rest else {k for each in runs for k in each.warm_logs}
    return explained(noise, gains_of(runs[0], runs[1], lambda output: True, warm))


def severity_of_outliers(model: Model, logs: Sequence[Record], masked: Mask) -> dict[str, Severity]:
    """By how much readings that are left out are off the model.

    Parameters
    ----------
    model : Model
    logs : sequence of Record
    masked : mapping of (digest, output) to ndarray of bool, shape (rows of the log,)
        The readings that are left out.
    """
    simulated = SimulatedLogs(model, tuple(logs), {})
    found: dict[str, list[np.ndarray]] = {}
    for k, log in enumerate(logs):
        for output in simulated.groups:
            rows = masked.get((log.digest, output))
            if rows is None:
                continue
            residual = simulated.residual(output)[k]
            off = np.where(rows, residual - np.nanmedian(residual[~rows]), 0.0)
            found.setdefault(output, []).append(off[np.isfinite(residual)])
    return {
        output: Severity(
            float(np.max(np.abs(np.concatenate(off)))),
            float(np.sqrt(np.mean(np.square(np.concatenate(off))))),
        )
        for output, off in found.items()
    }


def tolerances_of(given: Sequence[str], outputs: Sequence[str]) -> dict[str, float]:
    """Tolerances as they are typed: ``5um``, ``5`` in the outputs' unit, ``d_z_um=5um``.

    Parameters
    ----------
    given : sequence of str
        Later ones count; one without a channel holds for every output that its unit fits.
    outputs : sequence of str

    Returns
    -------
    dict of output to float [unit of the output]

    Raises
    ------
    UnitError
        No number above zero, no output of that name, a unit that fits no output, or none where
        outputs have several.
    """
    found: dict[str, float] = {}
    for text in given:
        channel, equals, quantity = text.rpartition("=")
        channel = channel.strip()
        if equals and channel not in outputs:
            raise UnitError(f"tolerance {text}: no output {channel!r}{hint(channel, outputs)}")
        value, unit = parse_quantity(quantity)
        if not 0 < value < np.inf:
            raise UnitError(f"tolerance {text}: a tolerance is above zero")
        meant = [channel] if equals else list(outputs)
        units = {name: parse_channel(name).unit for name in meant}
        if unit is None:
            if len(set(units.values())) > 1:
                raise UnitError(
                    f"tolerance {text}: outputs are in {', '.join(dict.fromkeys(units.values()))}: "
                    "give a unit (5um) or an output (d_z_um=5)"
                )
            found.update(dict.fromkeys(meant, value))
            continue
        own = {name: converted(value, unit, to) for name, to in units.items()}
        fits = {name: each for name, each in own.items() if each is not None}
        if not fits:
            raise UnitError(f"tolerance {text}: no output is in {unit}: {', '.join(meant)}")
        found.update(fits)
    return found
