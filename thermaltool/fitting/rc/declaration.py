"""A network as a TOML file declares it, read field by field; what is wrong is named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from thermaltool.documents import RC, Part, above_zero, finite, items, text
from thermaltool.errors import ModelError, UnitError
from thermaltool.fitting.declarations import known_fields, named_tables
from thermaltool.fitting.rc.network import (
    REST,
    RcBoundary,
    RcHeat,
    RcLink,
    RcNetwork,
    RcNode,
    RcParameter,
    Scale,
    is_power,
)
from thermaltool.record import hint
from thermaltool.units import is_absolute, is_temperature, parse_channel

# A term of the model document has up to so many lags.
MAX_NODES = 6


def load_network(document: Mapping[str, Any], name: str, source: str) -> RcNetwork:
    """The network in a table of TOML.

    Parameters
    ----------
    document : mapping
    name : str
        What the network is called where the file has no ``name``.
    source : str
        What messages call the file.

    Raises
    ------
    ModelError
        Another format or a newer version, an unknown or missing field, a value that it cannot
        have, ends that are not there; each names the file and the field.
    """
    whole = Part(RC.check(document, source))
    try:
        return _network(whole, name)
    except (ModelError, UnitError) as error:
        raise ModelError(f"{source}: {error}") from error


def _network(whole: Part, name: str) -> RcNetwork:
    known_fields(whole, "", "format", "version", "name", "nodes", "boundaries", "links", "heat")
    nodes = [_node(each, part) for each, part in named_tables(whole, "nodes")]
    boundaries = [_boundary(each, part) for each, part in named_tables(whole, "boundaries")]
    names = [node.name for node in nodes]
    for boundary in boundaries:
        if boundary.name in names:
            raise ModelError(f"boundaries.{boundary.name}: a node has this name, too")
    if not nodes:
        raise ModelError("nodes: there is none")
    if len(nodes) > MAX_NODES:
        raise ModelError(f"nodes: {len(nodes)}, and a network has at most {MAX_NODES}")
    links = []
    for each, part in named_tables(whole, "links"):
        link = _link(each, part, names, boundaries)
        # A channel between two links' ends is a boundary without an entry of its own.
        for end in link.ends:
            if end not in names and end not in [b.name for b in boundaries]:
                boundaries.append(RcBoundary(end, channel=end))
        links.append(link)
    heat = [_heat(each, part, names) for each, part in named_tables(whole, "heat")]
    network = RcNetwork(whole.read("name", text, name), tuple(nodes), tuple(boundaries),
                        tuple(links), tuple(heat))  # fmt: skip
    _check(network)
    return network


def _parameter(
    part: Part, place: str, field: str, unit: str, scale: Scale, default: float | None = None
) -> RcParameter:
    """A number to begin at, {start = ...}, {fixed = ...}, or nothing; `default` holds if given.

    A diffusion of 0 and a share of 1 hold: they are ends of what is searched.
    """
    path = f"{place}.{field}"

    def number(value: Any) -> float:
        if scale == "linear" or (field == "diffusion" and value == 0):
            return finite(value)
        found = above_zero(value)
        if scale == "logit" and found > 1:
            raise ModelError(f"not between 0 and 1: {found:g}")
        return found

    def reader(value: Any) -> RcParameter:
        if not isinstance(value, dict):
            start = number(value)
            held = (scale, start) in (("log", 0), ("logit", 1))
            return RcParameter(path, unit, scale, start, held)
        table = Part(value)
        known_fields(table, "", "start", "fixed")
        if len(value) > 1:
            raise ModelError("start or fixed, not both")
        fixed = "fixed" in value
        start = table.read("fixed" if fixed else "start", number, None)
        if scale == "logit" and not fixed and start == 1:
            raise ModelError("start: an estimated share is below 1")
        return RcParameter(path, unit, scale, start, fixed or (start == 0 and scale == "log"))

    if field not in part.names():
        return RcParameter(path, unit, scale, default, default is not None)
    found: RcParameter = part.read(field, reader)
    return found


def _node(name: str, part: Part) -> RcNode:
    place = f"nodes.{name}"
    known_fields(part, place, "capacity", "diffusion", "measured", "noise", "offset")
    capacity = _parameter(part, place, "capacity", "J/K", "log")
    channel = part.read("measured", _temperature, None)
    # A node that nobody measures shows its own process noise hardly.
    default = None if channel else 0.0
    diffusion = _parameter(part, place, "diffusion", "W s^0.5", "log", default)
    if channel is None:
        for field in ("noise", "offset"):
            if field in part.names():
                raise ModelError(f"{place}.{field}: the node is not measured")
        return RcNode(name, capacity, diffusion)
    return RcNode(name, capacity, diffusion, channel,
                  _parameter(part, place, "noise", "K", "log"),
                  _parameter(part, place, "offset", "K", "linear", 0.0))  # fmt: skip


def _boundary(name: str, part: Part) -> RcBoundary:
    place = f"boundaries.{name}"
    known_fields(part, place, "channel", "temperature")
    channel = part.read("channel", _temperature, None)
    if channel is not None and "temperature" in part.names():
        raise ModelError(f"{place}: a channel or a temperature, not both")
    if channel is not None:
        return RcBoundary(name, channel)
    return RcBoundary(name, None, _parameter(part, place, "temperature", "degC", "linear"))


def _link(name: str, part: Part, nodes: list[str], boundaries: list[RcBoundary]) -> RcLink:
    place = f"links.{name}"
    known_fields(part, place, "between", "conductance")
    ends = part.read("between", items)
    if len(ends) != 2:
        raise ModelError(f"{place}.between: two ends, not {len(ends)}")
    there = [*nodes, *(b.name for b in boundaries)]
    for end in ends:
        if end not in there:
            _channel_end(f"{place}.between", end, there)
    if ends[0] == ends[1]:
        raise ModelError(f"{place}.between: both ends are {ends[0]}")
    if not any(end in nodes for end in ends):
        raise ModelError(f"{place}.between: neither end is a node")
    conductance = _parameter(part, place, "conductance", "W/K", "log")
    return RcLink(name, (ends[0], ends[1]), conductance)


def _channel_end(place: str, end: Any, there: list[str]) -> None:
    """Refuse an end that is no temperature of the log either."""
    try:
        _temperature(end)
    except (ModelError, UnitError) as error:
        near = hint(str(end), there)
        raise ModelError(f"{place}: {end!r:.60} is no node, boundary or channel{near}") from error


def _heat(name: str, part: Part, nodes: list[str]) -> RcHeat:
    place = f"heat.{name}"
    known_fields(part, place, "channel", "node", "share", "gain")
    channel, node = part.read("channel", _channel), part.read("node", text)
    if node not in nodes:
        raise ModelError(f"{place}.node: {node!r:.60} is no node{hint(node, nodes)}")
    field, other = ("share", "gain") if is_power(channel) else ("gain", "share")
    if other in part.names():
        what = "in watts" if field == "share" else "not in watts"
        raise ModelError(f"{place}.{other}: {channel} is {what}: it has a {field}")
    if field == "gain":
        if field not in part.names():
            raise ModelError(f"{place}: {channel} is not in watts: 'gain' says its watts per unit")
        unit = f"W/{parse_channel(channel).unit}"
        return RcHeat(name, channel, node, _parameter(part, place, field, unit, "log"))
    if part.read("share", lambda value: value == REST, False):
        return RcHeat(name, channel, node, None)
    return RcHeat(name, channel, node, _parameter(part, place, field, "1", "logit", 1.0))


def _channel(value: Any) -> str:
    return parse_channel(text(value)).name


def _temperature(value: Any) -> str:
    channel = _channel(value)
    if not is_temperature(channel):
        raise ModelError(f"{channel} is no temperature")
    return channel


def _check(network: RcNetwork) -> None:
    """Refuse what no data can be fitted to."""
    outputs, nodes = network.outputs, [node.name for node in network.nodes]
    if not outputs:
        raise ModelError("nodes: none is measured")
    temperatures = (*outputs, *network.boundary_channels)
    for channel, count in Counter((*outputs, *network.inputs)).items():
        if count > 1:
            raise ModelError(f"{channel} has two roles: it is measured once, or it drives")
    if len(set(map(is_absolute, temperatures))) > 1:
        raise ModelError("temperatures and differences of them are never mixed: "
                         f"{', '.join(temperatures)}")  # fmt: skip
    for channel in network.heat_channels:
        into = [each for each in network.heat if each.channel == channel]
        rests = [each for each in into if each.weight is None]
        if rests and (len(rests) > 1 or len(into) != 2):
            raise ModelError(f"heat.{rests[0].name}.share: the rest of {channel} goes with exactly "
                             "one other entry of this channel")  # fmt: skip
    used = {end for link in network.links for end in link.ends}
    for boundary in network.boundaries:
        if boundary.name not in used:
            raise ModelError(f"boundaries.{boundary.name}: no link goes there")
    reached = {boundary.name for boundary in network.boundaries}
    while True:
        more = {e for link in network.links if set(link.ends) & reached for e in link.ends}
        if more <= reached:
            break
        reached |= more
    for node in nodes:
        if node not in reached:
            raise ModelError(f"nodes.{node}: no path of links to a boundary: its heat stays")
