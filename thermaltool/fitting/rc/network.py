"""A declared network: nodes, boundaries, links, heat, and the parameters that they have.

C_i dT_i = Σ_j G_ij (T_j − T_i) dt + Σ_h share_h Q_h dt + σ_i dW_i,   y = T_i + offset + e

(P. Bacher, H. Madsen, Identifying suitable models for the heat dynamics of buildings, Energy and
Buildings 43 (2011) 1511, eqs. 1 to 5; the form of CTSM-R.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from thermaltool.responses.modes import Hold
from thermaltool.units import UNITS, hold_of, parse_channel

# How a parameter is searched: by its logarithm, by ln(x/(1 − x)), or as it is.
Scale = Literal["log", "logit", "linear"]

# What stands for "the rest of this channel's heat".
REST = "rest"


@dataclass(frozen=True)
class RcParameter:
    """A number of the network.

    Attributes
    ----------
    name : str
        Its place in the declaration: ``nodes.motor.capacity``.
    unit : str
    scale : "log", "logit" or "linear"
        How it is searched.
    start : float or None [unit]
        Where the search begins, or the value that holds; None: found from the data.
    fixed : bool
        Whether it holds as given.
    """

    name: str
    unit: str
    scale: Scale
    start: float | None = None
    fixed: bool = False


@dataclass(frozen=True)
class RcNode:
    """A heat capacity: its parameters, and the channel that measures it where there is one.

    Attributes
    ----------
    name : str
    capacity : RcParameter [J/K]
    diffusion : RcParameter [W √s]
        Process noise, σ of the equation above.
    measured : str or None
    noise, offset : RcParameter or None [K]
        Standard deviation of a reading, and what is added to it; where it is measured.
    """

    name: str
    capacity: RcParameter
    diffusion: RcParameter
    measured: str | None = None
    noise: RcParameter | None = None
    offset: RcParameter | None = None


@dataclass(frozen=True)
class RcBoundary:
    """A temperature that the network does not change: a channel, or one constant.

    Attributes
    ----------
    name : str
    channel : str or None
    temperature : RcParameter or None
        Where there is no channel.
    """

    name: str
    channel: str | None = None
    temperature: RcParameter | None = None


@dataclass(frozen=True)
class RcLink:
    """A conductance [W/K] between a node and another node or a boundary.

    Attributes
    ----------
    name : str
    ends : (str, str)
    conductance : RcParameter
    """

    name: str
    ends: tuple[str, str]
    conductance: RcParameter


@dataclass(frozen=True)
class RcHeat:
    """A channel's heat into a node.

    Attributes
    ----------
    name, channel, node : str
    weight : RcParameter or None
        Fraction of a channel in watts, or watts per unit of another channel; None: what the other
        entry of the same channel leaves.
    """

    name: str
    channel: str
    node: str
    weight: RcParameter | None


@dataclass(frozen=True)
class RcNetwork:
    """Nodes, boundaries, links and heat.

    Attributes
    ----------
    name : str
    nodes : tuple of RcNode
    boundaries : tuple of RcBoundary
    links : tuple of RcLink
    heat : tuple of RcHeat
    """

    name: str
    nodes: tuple[RcNode, ...]
    boundaries: tuple[RcBoundary, ...]
    links: tuple[RcLink, ...]
    heat: tuple[RcHeat, ...]

    @cached_property
    def parameters(self) -> tuple[RcParameter, ...]:
        """All parameters, fixed ones among them, in the order of the declaration."""
        return tuple(self._parameters())

    def _parameters(self) -> Iterator[RcParameter]:
        for node in self.nodes:
            yield from (node.capacity, node.diffusion)
            if node.noise is not None and node.offset is not None:
                yield from (node.noise, node.offset)
        for boundary in self.boundaries:
            if boundary.temperature is not None:
                yield boundary.temperature
        yield from (link.conductance for link in self.links)
        yield from (each.weight for each in self.heat if each.weight is not None)

    @property
    def free(self) -> tuple[RcParameter, ...]:
        """Parameters that are estimated."""
        return tuple(p for p in self.parameters if not p.fixed)

    @property
    def measured(self) -> tuple[RcNode, ...]:
        """Nodes with a sensor."""
        return tuple(node for node in self.nodes if node.measured is not None)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Measured channels, in the order of the nodes."""
        return tuple(node.measured for node in self.nodes if node.measured is not None)

    @property
    def heat_channels(self) -> tuple[str, ...]:
        """Channels that heat."""
        return tuple(dict.fromkeys(each.channel for each in self.heat))

    @property
    def boundary_channels(self) -> tuple[str, ...]:
        """Channels of boundaries."""
        given = (each.channel for each in self.boundaries if each.channel is not None)
        return tuple(dict.fromkeys(given))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Channels that are read as inputs."""
        return (*self.heat_channels, *self.boundary_channels)

    @property
    def holds(self) -> tuple[Hold, ...]:
        """How each input goes on between its samples."""
        return tuple(map(hold_of, self.inputs))

    def index(self, name: str) -> int | None:
        """Number of a node; None for a boundary.

        Parameters
        ----------
        name : str
        """
        return next((k for k, node in enumerate(self.nodes) if node.name == name), None)

    def boundary(self, name: str) -> RcBoundary:
        """A boundary by its name.

        Parameters
        ----------
        name : str
        """
        return next(each for each in self.boundaries if each.name == name)


def unit_factor(channel: str) -> float:
    """Watts or kelvins of a channel's unit; 1 for other quantities, whose weight has the unit."""
    unit = parse_channel(channel).unit
    dimension, factor = UNITS[unit]
    return factor if dimension == "power" or dimension.startswith("temperature") else 1.0


def is_power(channel: str) -> bool:
    """Whether a channel is a heat in watts."""
    return parse_channel(channel).dimension == "power"
