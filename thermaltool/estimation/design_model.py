"""The model that an estimator is designed for: modes, noise of the sensors, a reference step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermaltool.effects.effect import Effect
from thermaltool.errors import FitError, ModelError
from thermaltool.estimation.balanced import balanced
from thermaltool.estimation.delay_lags import with_lags
from thermaltool.estimation.estimator import (
    Estimator,
    KalmanEstimator,
    KernelEstimator,
    SensorNoise,
)
from thermaltool.estimation.input_paths import InputPaths
from thermaltool.estimation.kernel import Regularization, invert_modes
from thermaltool.estimation.known_inputs import KnownInput, KnownInputEstimator
from thermaltool.estimation.permanent_effects import (
    apply_maps,
    check_supported,
    drive_maps,
    noise_amplification,
    reading_columns,
    spreading_joints,
)
from thermaltool.estimation.variable_cooling import check_cooling_supported, cooling_effects
from thermaltool.model import Model, Term, with_acting_terms
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.modes import Float, Modes
from thermaltool.responses.parallel import InputPath

# Least damping ratio [1] of a kernel: below it the regularized inverse rings.
MIN_DAMPING_RATIO = 0.3
# What the states that a Kalman form leaves out may do to a sensor at the level of the drive, as a
# share of its white noise; to any output as shares of its steady state: no more than a third of the
# error of a diffusive response's exponentials, no less than counts beside rounding.
LEFT_OUT, MAX_LEFT_OUT, MIN_LEFT_OUT = 0.01, 1e-5, 1e-7
# The trial step lasts so many of the slowest time constants of the sensors, and between so many
# samples: shorter ones show no steady state, longer ones only take time.
TRIAL_TIME_CONSTANTS, MIN_TRIAL_SAMPLES, MAX_TRIAL_SAMPLES = 6, 2000, 40000


# From a drive to a sensor or an output, by their places: (sensor or output, drive, response).
ModalTerm = tuple[int, int, Modes]


@dataclass(frozen=True)
class TruncatedTerms:
    """Responses of few states.

    Attributes
    ----------
    sensed, followed : tuple of ModalTerm
    error : float [1]
        What the largest truncation may do, as a share of the steady state of its response.
    """

    sensed: tuple[ModalTerm, ...]
    followed: tuple[ModalTerm, ...]
    error: float


@dataclass(frozen=True)
class DesignModel:
    """A model as an estimator is designed for it: responses as modes, and the level that counts.

    Attributes
    ----------
    sensors, drives, outputs : tuple of str
    sensed, followed : tuple of ModalTerm
    level : tuple of float
        Step of each drive for which the band is predicted.
    noise : tuple of SensorNoise
        Of the true values behind the readings.
    dt : float [s]
    known : tuple of KnownInput
        Columns beside the sensors; `to_sensors` and `to_outputs` are what they do there.
    losses : tuple of Effect
        By which the loss of heat changes.
    states : tuple of str
        Outputs by which it does, followed beside `outputs` where nothing is estimated.
    notes : tuple of str
        What a user should know of the model's effects at run time.
    """

    sensors: tuple[str, ...]
    drives: tuple[str, ...]
    outputs: tuple[str, ...]
    sensed: tuple[ModalTerm, ...]
    followed: tuple[ModalTerm, ...]
    level: tuple[float, ...]
    noise: tuple[SensorNoise, ...]
    dt: float
    known: tuple[KnownInput, ...] = ()
    to_sensors: tuple[InputPath, ...] = ()
    to_outputs: tuple[InputPath, ...] = ()
    losses: tuple[Effect, ...] = ()
    states: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The notes on effects, and what is read beside the sensors."""
        if not self.drives or not self.known:
            return self.notes
        return (*self.notes, f"read beside the sensors: {', '.join(k.channel for k in self.known)}")

    def finished(self, estimator: Estimator) -> Estimator:
        """An estimator with the columns that are read beside the sensors.

        Parameters
        ----------
        estimator : Estimator
        """
        if not self.known:
            return estimator
        return KnownInputEstimator(estimator, self.known, self.to_sensors, self.to_outputs)

    def kalman(self, walk: Sequence[float]) -> KalmanEstimator:
        """The Kalman form for given random-walk rates [unit of the drive/√s].

        Parameters
        ----------
        walk : sequence of float, one for each drive [unit of the drive/√s]
        """
        return KalmanEstimator(
            self.sensors,
            self.drives,
            self.outputs,
            self.truncated.sensed,
            self.truncated.followed,
            tuple(walk),
            self.noise,
        )

    @cached_property
    def truncated(self) -> TruncatedTerms:
        """The responses with the states that count beside the noise."""

        def least(terms: Sequence[ModalTerm], noise: Sequence[SensorNoise]) -> list[ModalTerm]:
            found = []
            for to, drive, modes in terms:
                steady = abs(modes.dc_gain())
                allowed = MAX_LEFT_OUT * steady
                if noise:
                    seen = LEFT_OUT * noise[to].white / max(abs(self.level[drive]), 1e-300)
                    allowed = max(min(allowed, seen), MIN_LEFT_OUT * steady)
                kept, error = balanced(modes, allowed)
                errors.append(error / max(steady, 1e-300))
                found.append((to, drive, kept))
            return found

        errors: list[float] = []
        sensed, followed = least(self.sensed, self.noise), least(self.followed, ())
        return TruncatedTerms(tuple(sensed), tuple(followed), max(errors, default=0.0))

    @staticmethod
    def of(
        model: Model, noise: Mapping[str, SensorNoise], dt: float, measured: Sequence[str] = ()
    ) -> DesignModel:
        """The machine of a model document, for samples of `dt` [s].

        Where every drive is measured, and where the model has no sensor, there is nothing to
        estimate: no sensor is read, and `drives` is empty.

        Parameters
        ----------
        noise : mapping of column to SensorNoise
        measured : sequence of str
            Drives that are read at run time.

        Raises
        ------
        ModelError
            Neither a deflection nor a sensor in the model, a drive that no sensor sees, the noise
            of a sensor not given or zero, or an effect that no estimator can follow.
        """
        model = with_acting_terms(model)
        every = [d.channel for d in model.drives]
        for name in measured:
            if name not in every:
                raise ModelError(f"no drive {name} in the model; there are: {', '.join(every)}")
        # What a contact temperature is need not be estimated: it is read.
        told = {joint.partner for joint in spreading_joints(model)}
        outputs = tuple(o.channel for o in model.deflections if o.channel not in told)
        if not outputs and not model.sensors:
            raise ModelError("the model has neither a deflection nor a sensor: nothing to estimate")
        given = tuple(every if not model.sensors else measured)
        _examine_bands(model, given)
        notes, losses = check_supported(model, given), cooling_effects(model)
        check_cooling_supported(model, given)
        sensors = tuple(o.channel for o in model.sensors) if set(every) - set(given) else ()
        columns = reading_columns(model)
        for sensor in sensors:
            if columns[sensor] not in noise:
                raise ModelError(
                    f"no noise for the sensor {columns[sensor]}: not measured, or zero in a log "
                    f"where it was constant; there is {', '.join(noise) or 'none'}"
                )
            if not noise[columns[sensor]].white > 0:
                raise ModelError(
                    f"the noise of {columns[sensor]} is zero: an estimate weighs it; measure it on "
                    "readings that move (thermaltool noise)"
                )
        seen = [t.drive for t in model.terms if t.output in sensors]
        drives = tuple(name for name in every if name in seen and name not in given)
        lost = [t.drive for t in model.terms if t.drive not in (*drives, *given)]
        if lost:
            raise ModelError(
                f"no sensor sees the drive {lost[0]}: it cannot be estimated; where it is "
                f"measured: --measured {lost[0]}"
            )
        by = set() if drives else {effect.channel for effect in losses}
        states = tuple(o.channel for o in model.outputs if o.channel in by - set(outputs))
        paths = InputPaths(model, dt, given, sensors, (*outputs, *states))
        if not drives and not outputs:
            raise ModelError("every drive is measured, and the model has no deflection to estimate")
        if not drives and not paths.known:
            raise ModelError("nothing acts on the deflections of the model")

        late: list[str] = []

        def prompt(t: Term) -> Modes:
            response = paths.response(t)
            what = "direct feedthrough"
            if isinstance(response, DelayedModes):
                try:
                    modes, error = with_lags(response)
                except ModelError as reason:
                    what = str(reason)
                else:
                    late.append(
                        f"{t.output} answers {t.drive} {response.delay:.3g} s late: the estimator "
                        f"takes lags for that, which follow it to {100 * error:.2g} %"
                    )
                    return modes
            elif not response.direct:
                return response
            raise ModelError(
                f"{t.drive} → {t.output} has {what}: such a drive cannot be estimated; "
                f"where it is measured: --measured {t.drive}; else calibrate with a kind that has "
                f"none: --response {t.output}=rational3"
            )

        def terms(targets: tuple[str, ...]) -> tuple[ModalTerm, ...]:
            own = [t for t in model.terms if t.output in targets and t.drive in drives]
            followed = [(t.output, t.drive, prompt(t)) for t in own]
            followed += [
                (o, drive, with_lags(modes)[0] if isinstance(modes, DelayedModes) else modes)
                for o in targets
                for drive, modes in paths.redirected(o)
            ]
            return tuple(
                (targets.index(o), drives.index(drive), modes)
                for o, drive, modes in followed
                if drive in drives
            )

        levels = {d.channel: np.array([max(map(abs, d.range))]) for d in model.drives}
        sensed, driven = terms(sensors), terms(outputs)
        return DesignModel(
            sensors,
            drives,
            outputs,
            sensed,
            driven,
            # What acts at the largest level.
            tuple(float(apply_maps(drive_maps(model, name), levels[name])[0]) for name in drives),
            tuple(
                _of_truth(noise[columns[name]], noise_amplification(model, name))
                for name in sensors
            ),
            dt,
            paths.known,
            paths.to(sensors),
            paths.to((*outputs, *states)),
            losses,
            states,
            (*notes, *late),
        )

    @cached_property
    def clock(self) -> Float:
        """Times of the trial: six of the slowest time constants of the sensors, within reason."""
        slowest = max(1 / np.min(-modes.poles.real) for _, _, modes in self.sensed)
        samples = int(
            np.clip(TRIAL_TIME_CONSTANTS * slowest / self.dt, MIN_TRIAL_SAMPLES, MAX_TRIAL_SAMPLES)
        )
        return np.asarray(self.dt * np.arange(samples), float)

    @cached_property
    def trials(self) -> list[tuple[Float, Float]]:
        """For a step of each drive: readings (n, sensors) and deflections (n, outputs)."""
        trials = []
        for drive, level in enumerate(self.level):
            readings = np.zeros((len(self.clock), len(self.sensors)))
            truth = np.zeros((len(self.clock), len(self.outputs)))
            for table, terms in ((readings, self.sensed), (truth, self.followed)):
                for target, source, modes in terms:
                    if source == drive:
                        table[:, target] += level * modes.step(self.clock)
            trials.append((readings, truth))
        return trials

    def kernel(
        self, regularization: Regularization, cutoff: float, delay: float
    ) -> KernelEstimator:
        """The kernel form; one sensor, one drive.

        Parameters
        ----------
        regularization : Regularization
        cutoff : float [Hz]
            Of the filter.
        delay : float [s]
            Artificial delay.
        """
        response = self.single()
        inverse = invert_modes(response, regularization)
        if inverse.damping < MIN_DAMPING_RATIO:
            raise FitError(f"the kernel rings: damping ratio {inverse.damping:.2f}")
        return KernelEstimator(
            self.sensors[0],
            self.drives[0],
            self.outputs,
            inverse.filtered(cutoff),
            self.followed,
            delay,
        )

    def single(self) -> Modes:
        """The one response that the kernel form inverts.

        Raises
        ------
        FitError
            More sensors or drives than one, or a loss of heat that changes.
        """
        if len(self.sensed) != 1 or len(self.drives) != 1:
            raise FitError("the kernel form takes one sensor and one drive; use --form kalman")
        for effect in self.losses:
            raise FitError(f"the kernel form cannot follow {effect.name}; use --form kalman")
        return self.sensed[0][2]


def _of_truth(noise: SensorNoise, slope: float) -> SensorNoise:
    return SensorNoise(slope * noise.white, slope * noise.drift, noise.drift_time)


def _examine_bands(model: Model, measured: Sequence[str]) -> None:
    """A schedule bends its drives: they are read, and what chooses is read or no drive."""
    drives = [d.channel for d in model.drives]
    for term in model.terms:
        if term.band is None:
            continue
        for channel in (term.drive, term.band.channel):
            if channel in drives and channel not in measured:
                raise ModelError(
                    f"{channel} has a schedule of transfer functions: it cannot be estimated; "
                    f"where it is measured: --measured {channel}"
                )
