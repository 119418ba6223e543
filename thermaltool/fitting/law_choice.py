"""Whether a law of its own holds before the responses: of a drive, or of the machine's material.

Heat goes with the square of a voltage, friction with a power of the speed, a motor's loss with
more than its load: a power law or a parabola of the drive, the same for every output (Hammerstein).
What a hot machine is made of stores more heat or conducts it worse: its own time goes slower. A
linear model leaves of that an error of structure that every later log shows again. Where the hot
material conducts heat better, a temperature bends with its own height. As with kinds of response,
evidence and rows held out decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermaltool.effects.channels import ROOM_DEGC
from thermaltool.effects.drive_nonlinearity import DriveNonlinearity
from thermaltool.effects.dynamics import from_rest
from thermaltool.effects.effect import Effect
from thermaltool.effects.heat_capacity import HeatCapacity
from thermaltool.effects.sensor_conversion import SensorConversion
from thermaltool.fitting.acting_record import acting_records
from thermaltool.fitting.averaging import row_noise
from thermaltool.fitting.hold_choice import ChosenKinds
from thermaltool.fitting.law_search import LawSearch
from thermaltool.fitting.laws import LOSSES, Law
from thermaltool.fitting.projection import GridStates
from thermaltool.fitting.response_choice import MIN_ROWS
from thermaltool.fitting.response_search import FittedKinds, KindSearch, independent_rows
from thermaltool.fitting.sound_kinds import DECISIVE
from thermaltool.model import Drive, relative
from thermaltool.model.rest import rest_level
from thermaltool.record import Record
from thermaltool.responses.modes import Float
from thermaltool.units import is_absolute, is_temperature

# Levels beside rest and the largest that count as one [of the largest].
SAME_LEVEL = 0.02
# Between which a temperature goes.
LEVEL_QUANTILES = (0.005, 0.995)
# Of the squared error beyond the noise, where that is larger than the noise, a nonlinearity leaves
# at most this share. Laws that hold leave less than a tenth; what merely comes near to another
# error of structure leaves a quarter and more, and predicts other logs no better. No output's error
# on held-out rows may be larger by this factor [squared], and decisively.
MAX_LEFT_BY_LAW, MAX_WORSE = 0.15, 1.05
# ... or this one, where that is as near to a reading's noise: a drift or the steps of a reading are
# more than white.
MAX_LEFT_AT_NOISE, AT_NOISE = 1 / 3, 1.5


def laws_of(
    records: Sequence[Record],
    drives: Sequence[Drive],
    chosen: Sequence[ChosenKinds],
    known: Sequence[Effect],
    fixed: Mapping[str, float],
    free_start: bool,
    losses: bool = True,
) -> tuple[Effect, ...]:
    """Laws with which the same kinds of response describe the records decisively better.

    Measured temperatures are taken as they are: they are no commands. What holds by the temperature
    of the machine is not tried where it may begin warm.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    chosen : sequence of ChosenKinds
        Of every output.
    known : sequence of Effect
        As they were found with other kinds.
    fixed : mapping of parameter name to value
    free_start : bool
        See `fit_output`.
    losses : bool
        Whether more heat for each kelvin may be lost where the machine is hot.

    Returns
    -------
    tuple of Effect
        With their standard errors.
    """
    if sum(len(record) for record in records) < MIN_ROWS * len(drives):
        return ()
    laws = [
        Law(DriveNonlinearity, d.channel, level)
        for k, d in enumerate(drives)
        if _drives(chosen, k) and (level := _level(records, d))
    ]
    levels = {} if free_start else _levels(records, chosen)
    if not laws and not levels:
        return ()
    # Rows that a known nonlinearity explains are no outliers.
    acting, zeroed = acting_records(records, drives, known, comparable=True)
    states: GridStates = {}
    tasks = [
        KindSearch(
            acting,
            [zeroed[d] for d in each.drives],
            each.output,
            free_start,
            fixed,
            states,
            each.equilibrium,
        )
        for each in chosen
    ]
    if levels:
        hottest = max(levels, key=lambda channel: abs(levels[channel]))
        laws.append(Law(HeatCapacity, hottest, abs(levels[hottest])))
        # A room as a drive moves the level at rest, from which a reading bends and heat is lost.
        if not any(is_absolute(drive.channel) for drive in drives):
            if losses:
                laws += _losses(records, chosen, tasks, hottest, levels[hottest])
            laws += [Law(SensorConversion, channel, level) for channel, level in levels.items()]
    return tuple(LawSearch(records, drives, chosen, tasks, laws).found(known))


def explain(
    records: Sequence[Record],
    drives: Sequence[Drive],
    plain: Sequence[ChosenKinds],
    chosen: Sequence[ChosenKinds],
    effects: Sequence[Effect],
    fixed: Mapping[str, float],
    free_start: bool,
) -> tuple[ChosenKinds, ...] | None:
    """Kinds that are kept beside laws; None where the laws leave much, or predict rows worse.

    They leave little beyond the noise of some output, for another may have another error. Of all of
    them where the machine loses more heat when hot: what one place loses, a loss everywhere and a
    curve of the drive explain in part. Kinds are chosen anew beside laws; those from before are
    kept where the new ones predict held-out rows decisively worse: it is not the laws that do.

    Parameters
    ----------
    records : sequence of Record
    drives : sequence of Drive
    plain, chosen : sequence of ChosenKinds
        Of every output, without the laws and with them.
    effects : sequence of Effect
    fixed, free_start
        As for `laws_of`.

    Returns
    -------
    tuple of ChosenKinds or None
        Of `plain`, those that are kept.
    """
    large, left, worse, kept = [], [], [], list[ChosenKinds]()
    for before, after in zip(plain, chosen, strict=True):
        fits = []
        for each, laws in ((before, ()), (after, effects), (before, effects)):
            acting, zeroed = acting_records(records, drives, laws, comparable=True)
            own = [zeroed[d] for d in each.drives]
            task = KindSearch(acting, own, each.output, free_start, fixed, {}, each.equilibrium)
            fits.append(each.fitted(task))
        usual, other, same = fits
        if usual is None or other is None:
            return None
        noise = max(row_noise(r, before.output) for r in records) ** 2
        size, *rests = (float(np.mean(fit.residual**2)) for fit in fits if fit is not None)
        large.append(size > 2 * noise)
        # A simpler kind that will do beside the laws leaves more than the laws do.
        beyond = size - noise
        near = min(MAX_LEFT_AT_NOISE * beyond, (AT_NOISE**2 - 1) * noise)
        most = max(MAX_LEFT_BY_LAW * beyond, near)
        left.append(min(rests) - noise < most)
        if same is not None and _is_worse(other, same):
            kept, other = [*kept, before], same
        worse.append(_is_worse(other, usual))
    explained, open_ = np.array(large) & np.array(left), np.array(large) & ~np.array(left)
    if any(isinstance(effect, LOSSES) for effect in effects) and np.any(open_):
        return None
    return tuple(kept) if np.any(explained) and not np.any(worse) else None


def _held_out(fit: FittedKinds) -> float:
    """Mean square of the errors on held-out rows."""
    return float(np.mean(fit.held_out**2))


def _is_worse(fit: FittedKinds, other: FittedKinds) -> bool:
    """Whether a fit predicts held-out rows decisively worse, by as many as are independent."""
    factor = _held_out(fit) / max(_held_out(other), np.finfo(float).tiny)
    rows = independent_rows(fit.held_out)
    return factor > MAX_WORSE and rows * float(np.log(factor)) > DECISIVE


def _losses(
    records: Sequence[Record],
    chosen: Sequence[ChosenKinds],
    tasks: Sequence[KindSearch],
    hottest: str,
    level: float,
) -> list[Law]:
    """A loss that rises with the hottest temperature; none where nothing is hotter than rest."""
    k = next(k for k, each in enumerate(chosen) if each.output == hottest)
    # One lag is slow as the machine loses its heat, whatever a kind that is bent to fit has found.
    one = ("rational1",) * len(tasks[k].drives)
    fit = tasks[k].fit(one, chosen[k].delays, common=True) if level > 0 else None
    if fit is None:
        return []
    rest = ROOM_DEGC
    if is_absolute(hottest):
        rest = float(np.mean([rest_level(r.column(hottest), "first", "first") for r in records]))
    slowest = max(response.slowest() for response in fit.responses)
    return [Law(effect, hottest, level, rest, slowest) for effect in LOSSES]


def _drives(chosen: Sequence[ChosenKinds], drive: int) -> bool:
    return any(drive in each.drives for each in chosen)


def _levels(records: Sequence[Record], chosen: Sequence[ChosenKinds]) -> dict[str, float]:
    """How far each temperature among the outputs moves [K], with its sign; none that does not."""
    found = {}
    for each in chosen:
        # One that a log does not have says nothing of the machine there.
        if is_temperature(each.output) and all(np.isfinite(r.column(each.output)).any()
                                               for r in records):  # fmt: skip
            rises = np.concatenate([from_rest(record, each.output) for record in records])
            # A few outliers are no level.
            ends = np.quantile(rises, LEVEL_QUANTILES)
            if level := float(max(ends, key=abs)):
                found[each.output] = level
    return found


def _level(records: Sequence[Record], drive: Drive) -> float:
    """Largest level of a drive of which a nonlinearity could be seen; 0 where there is none."""
    if is_temperature(drive.channel):
        return 0.0
    u = [relative(r.column(drive.channel), drive.reference, drive.hold) for r in records]
    size = np.abs(np.concatenate(u))
    return float(np.max(size)) if has_levels(size) else 0.0


def has_levels(size: Float) -> bool:
    """Whether there are levels beside rest and the largest.

    Parameters
    ----------
    size : ndarray, shape (n,)
        0 or above.
    """
    level = float(np.max(size))
    return bool(np.any((size > SAME_LEVEL * level) & (size < (1 - SAME_LEVEL) * level)))
