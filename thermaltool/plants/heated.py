"""A structure with two heaters: one that bends it, one that can bend it back.

After Mareš et al.: a causal and a stabilization heater sit asymmetrically on the surface, each
behind a voltage regulator; two temperatures are read close to them, and three displacement probes
see the fictitious tool. `quill` and `c_frame` are the two structures: finite volumes for heat and
beams for bending, no finite elements; `tubes` says why.

Chosen, for nothing of it is printed: regulators, film, heaters. A voltage regulator heats with the
square of its voltage, one by phase angle with x - sin(2 pi x)/(2 pi) of full power at the share x
of its travel; a scale in watts leaves a part of both. Natural convection goes with the fourth root
of the rise, radiation nearly with the rise itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermaltool.plants.noise import Sensor
from thermaltool.plants.tubes import Chain, join

Array = NDArray[np.float64]
Pair = tuple[float, float]

HEATERS = ("causal", "stabilization")
POWERS = tuple(f"Q_{name}_W" for name in HEATERS)
OUTPUTS = ("T_causal_degC", "T_stabilization_degC", "d_x1_um", "d_x2_um", "d_z_um")
# Chosen: resistance thermometers, and probes averaged over the sample of a minute.
SENSORS = {
    "degC": Sensor(white=0.02, drift=0.02, drift_time=3600.0, decimals=3),
    "um": Sensor(white=0.05, drift=0.05, drift_time=7200.0, decimals=3),
}
_FILM_RISE = 10.0  # rise at which the film coefficient is given [K]


@dataclass(frozen=True)
class Regulator:
    """From the power that is set to the power that heats [W].

    Attributes
    ----------
    full : float [W]
        Where both agree, as they do at zero.
    exponent : float
        1 for a straight scale, 2 for one that is marked by voltage.
    bend : float
        1 for a phase-angle regulator marked by its travel, 0 for none.
    """

    full: float
    exponent: float
    bend: float

    def power(self, setting: Array) -> Array:
        """Power for any setting, which is limited to 0 ... full [W]."""
        share = np.clip(setting / self.full, 0.0, 1.0) ** self.exponent
        return np.asarray(
            self.full * (share - self.bend * np.sin(2 * np.pi * share) / (2 * np.pi)), float
        )


@dataclass(frozen=True)
class Pad:
    """A heater: the pieces of the structure that it covers, and itself.

    Attributes
    ----------
    pieces : tuple of int
    capacity : float [J/K]
    contact : float [W/K]
        To the structure.
    probe : int
        The piece beside it whose temperature is read.
    regulator : Regulator
    """

    pieces: tuple[int, ...]
    capacity: float
    contact: float
    probe: int
    regulator: Regulator


@dataclass(frozen=True)
class Film:
    """Loss to the air [W/(m² K)].

    Attributes
    ----------
    natural : float
        Convection at a rise of 10 K; it goes with the fourth root.
    steady : float
        What does not change with the rise.
    """

    natural: float
    steady: float


@dataclass(frozen=True)
class HeatedPlant:
    """Heat balance and geometry, assembled.

    Attributes
    ----------
    capacity : (n,) ndarray [J/K]
        Of the pieces, then of both heaters.
    balance : (n, n) ndarray [W/K]
        Conductances, and the film at its usual rise.
    natural : (n,) ndarray [W/K]
        The part of the film that goes with the fourth root.
    film : (n,) ndarray [W/K]
        The whole of it.
    rows : (5, n) ndarray
        `OUTPUTS` of the rises, in their units per kelvin.
    regulators : (Regulator, Regulator)
    distance : float [mm]
        Between the two probes of x.
    """

    capacity: Array
    balance: Array
    natural: Array
    film: Array
    rows: Array
    regulators: tuple[Regulator, Regulator]
    distance: float

    def start(self, dt: float, air: float) -> HeatedRun:
        """A run from rest at the temperature of the air [degC]."""
        return HeatedRun(self, dt, air)

    def simulate(self, powers: Array, air: Array, dt: float) -> dict[str, Array]:
        """Outputs without noise, from rest at the first temperature of the air.

        Parameters
        ----------
        powers : (m, 2) ndarray
            Settings of both regulators [W], held from each sample to the next.
        air : (m,) ndarray [degC]
        dt : float [s]

        Returns
        -------
        dict of channel to (m,) ndarray
        """
        run = self.start(dt, float(air[0]))
        samples = np.empty((len(powers), len(OUTPUTS)))
        for k, (setting, now) in enumerate(zip(powers, air, strict=True)):
            samples[k] = run.outputs()
            run.advance(setting, float(now))
        return dict(zip(OUTPUTS, samples.T, strict=True))

    def _bent(self, rise: Array) -> Array:
        """Loss beyond that of the film at its usual rise, shape (n,) [W]."""
        factor = np.sqrt(np.sqrt(np.abs(rise) / _FILM_RISE)) - 1.0
        return np.asarray(self.natural * factor * rise)


class HeatedRun:
    """A plant in time; `outputs` before `advance`, sample by sample.

    The linear part is exact for what is held over a sample, the bent part of the film of second
    order in the sample.
    """

    def __init__(self, plant: HeatedPlant, dt: float, air: float) -> None:
        self._plant, self._first, self._air = plant, air, 0.0
        root = np.sqrt(plant.capacity)
        rates, shapes = np.linalg.eigh(plant.balance / np.outer(root, root))
        left, right = shapes / root[:, None], (shapes * root[:, None]).T
        self._decay = (left * np.exp(-rates * dt)) @ right
        self._gain = (left * (-np.expm1(-rates * dt) / rates)) @ left.T
        self._rise = np.zeros(len(plant.capacity))

    def outputs(self) -> list[float]:
        """`OUTPUTS` now; temperatures absolute, displacements from the start."""
        values = self._plant.rows @ self._rise
        values[:2] += self._first
        readings: list[float] = values.tolist()
        return readings

    def advance(self, settings: Array, air: float) -> None:
        """One sample with held settings [W] and air [degC]."""
        plant, air = self._plant, air - self._first
        heat = plant.film * air
        heat[-2:] += [
            float(r.power(np.asarray(s))) for r, s in zip(plant.regulators, settings, strict=True)
        ]
        free = self._decay @ self._rise + self._gain @ heat
        before = plant._bent(self._rise - air)
        after = plant._bent(free - self._gain @ before - air)
        self._rise = free - self._gain @ ((before + after) / 2)


def pad(
    chain: Chain, tube: int, first: int, sectors: tuple[int, int], probe: int, regulator: Regulator
) -> Pad:
    """A heater of 150 J/K with a contact of 4 W/K, chosen, on two segments of a tube.

    Parameters
    ----------
    chain : Chain
    tube, first : int
        The tube, and the first of the two segments.
    sectors : (int, int)
        What of the girth it covers.
    probe : int
        The segment whose temperature is read, in the first of the sectors.
    regulator : Regulator
    """
    covered = tuple(chain.at(tube, first + k, s) for k in (0, 1) for s in sectors)
    return Pad(covered, 150.0, 4.0, chain.at(tube, probe, sectors[0]), regulator)


def assemble(
    chain: Chain, film: Film, pads: tuple[Pad, Pad], probes: tuple[Pair, Pair]
) -> HeatedPlant:
    """The plant of a chain of tubes with two heaters.

    Parameters
    ----------
    chain : Chain
    film : Film
    pads : (Pad, Pad)
        Causal, stabilization.
    probes : ((x, z), (x, z)) [m]
        Where the two probes of x see the tool; the first one's end face is that of z.
    """
    pieces = chain.pieces
    n = pieces + len(pads)
    capacity = np.concatenate([chain.capacity(), [pad.capacity for pad in pads]])
    surface = np.concatenate([chain.surface(), np.zeros(len(pads))])
    balance = np.zeros((n, n))
    balance[:pieces, :pieces] = chain.conductance()
    for number, pad in enumerate(pads):
        heater = pieces + number
        for piece in pad.pieces:
            join(balance, heater, piece, pad.contact / len(pad.pieces))
    whole = (film.natural + film.steady) * surface
    balance += np.diag(whole)
    near, far = probes
    first, second = chain.motion(near), chain.motion(far)
    rows = np.zeros((len(OUTPUTS), n))
    rows[[0, 1], [pad.probe for pad in pads]] = 1.0
    rows[2, :pieces], rows[3, :pieces], rows[4, :pieces] = first[0], second[0], first[1]
    distance = 1e3 * float(np.hypot(*np.subtract(far, near)))
    regulators = (pads[0].regulator, pads[1].regulator)
    return HeatedPlant(capacity, balance, film.natural * surface, whole, rows, regulators, distance)
