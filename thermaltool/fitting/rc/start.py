"""Where a search begins: gains and time constants of the data, spread over the network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import qmc

from thermaltool.fitting.rc.data import FilterPiece
from thermaltool.fitting.rc.network import RcNetwork, is_power, unit_factor
from thermaltool.fitting.rc.parameters import searched

Array = NDArray[np.float64]

# Time constants that the scale is looked for at, and starts that are compared.
_TIMES, _STARTS = 24, 64
# Log-widths over which what nobody has declared is spread, about its scale.
_SPREAD = 2.0
# How far off a network is nearly the smaller one that it has as a limit.
_FAR = 5.0


@dataclass(frozen=True)
class DataScale:
    """What one lump would be.

    Attributes
    ----------
    conductance : float [W/K]
    capacity : float [J/K]
    noise : float [K]
        Of a reading, from differences of neighbours.
    period : float [s]
    level : float
        Mean of the readings, in K or °C.
    """

    conductance: float
    capacity: float
    noise: float
    period: float
    level: float


def data_scale(network: RcNetwork, pieces: Sequence[FilterPiece]) -> DataScale:
    """One lag from all inputs to the mean of the readings: its time constant and gain.

    Parameters
    ----------
    network : RcNetwork
    pieces : sequence of FilterPiece
    """
    piece = max(pieces, key=len)
    factor = np.array([unit_factor(channel) for channel in network.outputs])
    there = np.any(piece.present, axis=1)
    y = np.nanmean(np.where(there[:, None], piece.readings * factor, 0.0), axis=1)
    period = float(np.median(np.diff(piece.time)))
    duration = float(piece.time[-1] - piece.time[0])
    heat = sum(
        (piece.inputs[:, k] * (unit_factor(name) if is_power(name) else _watts(network, name))
         for k, name in enumerate(network.heat_channels)),
        start=np.zeros(len(piece)),
    )  # fmt: skip
    rooms = len(network.boundary_channels)
    others = [piece.inputs[:, len(network.heat_channels) + k] for k in range(rooms)]
    best = (np.inf, duration, 1.0)
    for tau in np.geomspace(2 * period, 3 * duration, _TIMES).tolist():
        decay = np.exp(-period / tau)
        lagged = [lfilter([0.0, 1 - decay], [1.0, -decay], x - x[0]) for x in (heat, *others)]
        free = np.exp(-(piece.time - piece.time[0]) / tau)
        design = np.column_stack([*lagged, free, np.ones(len(piece))])[there]
        answer, *_ = np.linalg.lstsq(design, y[there], rcond=None)
        error = float(np.sum((y[there] - design @ answer) ** 2))
        if error < best[0]:
            best = error, tau, abs(float(answer[0]))
    _, tau, gain = best
    conductance = 1.0 / gain if np.ptp(heat) > 0 and gain > 0 else 1.0
    second = np.diff(piece.readings * factor, n=2, axis=0)
    spread = float(np.nanmax(y[there]) - np.nanmin(y[there])) or 1.0
    noise = float(np.nanmedian(np.abs(second))) / 0.6745 / np.sqrt(6.0)
    return DataScale(conductance, conductance * tau, max(noise, 1e-5 * spread), period,
                     float(np.mean(y[there])))  # fmt: skip


def _watts(network: RcNetwork, channel: str) -> float:
    """Watts per unit of a channel, as far as it is declared."""
    given = [each.weight.start for each in network.heat if each.channel == channel and each.weight]
    return float(sum(value or 1.0 for value in given))


def starts(network: RcNetwork, scale: DataScale, known: Mapping[str, float]) -> Array:
    """Vectors to begin at, shape (s, p): what is declared holds, the rest is spread.

    Parameters
    ----------
    network : RcNetwork
    scale : DataScale
    known : mapping of name to value
        Estimates of a smaller network; some starts are near them, the second one where the
        network is nearly the smaller one, others ignore them. Its noise says nothing: there it
        explains what the smaller network cannot.
    """
    noise = (".diffusion", ".noise")
    known = {name: value for name, value in known.items() if not name.endswith(noise)}
    spread = [_spread(network, scale, {})]
    if known:
        spread.insert(0, _spread(network, scale, known))
    return np.vstack(spread)


def _spread(network: RcNetwork, scale: DataScale, known: Mapping[str, float]) -> Array:
    middle = np.array([_middle(network, scale, known, k) for k in range(len(network.free))])
    width = np.array([0.0 if p.start is not None or p.scale == "linear"
                      else 0.1 * _SPREAD if p.name in known
                      else _SPREAD for p in network.free])  # fmt: skip
    points = qmc.Halton(len(middle), scramble=False).random(_STARTS)
    points[0] = 0.5
    found = np.asarray(middle + 2 * width * (points - 0.5))
    found[1] = np.where(width > 0, middle + _limit(network), middle)
    return found


def _limit(network: RcNetwork) -> Array:
    """By how much logarithms move until nodes without a sensor nearly follow their neighbours."""
    hidden = {f"nodes.{node.name}.capacity" for node in network.nodes if node.measured is None}
    inner = {e.conductance.name for e in network.links if None not in map(network.index, e.ends)}
    return np.array([-_FAR if p.name in hidden else _FAR if p.name in inner else 0.0
                     for p in network.free])  # fmt: skip


def _middle(network: RcNetwork, scale: DataScale, known: Mapping[str, float], k: int) -> float:
    """Where one parameter is searched about."""
    parameter = network.free[k]
    value = parameter.start if parameter.start is not None else known.get(parameter.name)
    if value is None:
        value = _by_scale(network, scale, parameter.name)
    return searched(parameter, value)


def _by_scale(network: RcNetwork, scale: DataScale, name: str) -> float:
    kind = name.rpartition(".")[2]
    n = len(network.nodes)
    if kind == "capacity":
        return scale.capacity / n
    if kind == "conductance":
        grounds = [e for e in network.links if None in map(network.index, e.ends)]
        outward = any(link.conductance.name == name for link in grounds)
        return scale.conductance / len(grounds) if outward else 3.0 * scale.conductance
    if kind == "diffusion":
        # As large as moves a reading by a third of its noise from row to row.
        return 0.3 * scale.capacity / n * scale.noise / np.sqrt(scale.period)
    if kind == "noise":
        return scale.noise
    if kind == "temperature":
        return scale.level
    return 0.5 if kind == "share" else 1.0 if kind == "gain" else 0.0
