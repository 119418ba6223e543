"""Networks beside each other: which is nested in which, and which is enough.

A. W. van der Vaart, Asymptotic Statistics (1998), 16; the forward selection of P. Bacher and
H. Madsen, Energy and Buildings 43 (2011) 1511.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import chdtrc

from thermaltool.errors import FitError
from thermaltool.fitting.rc.fit import RcFit
from thermaltool.fitting.rc.network import RcNetwork

# Below this p-value a larger network is taken.
SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class LikelihoodRatio:
    """A network against one that it is nested in.

    Attributes
    ----------
    smaller, larger : str
        Names of the networks.
    statistic : float
        Twice the difference of the log-likelihoods.
    dof : int
        By how many parameters they differ.
    """

    smaller: str
    larger: str
    statistic: float
    dof: int

    @property
    def p_value(self) -> float:
        """Probability of so large a ratio if the smaller network were true, by χ²."""
        return float(chdtrc(self.dof, max(self.statistic, 0.0)))


@dataclass(frozen=True)
class RcComparison:
    """Fits of several networks to the same readings.

    Attributes
    ----------
    fits : tuple of RcFit
        By their number of parameters.
    tests : tuple of LikelihoodRatio
        Of every nested pair.
    """

    fits: tuple[RcFit, ...]
    tests: tuple[LikelihoodRatio, ...]

    @property
    def sufficient(self) -> RcFit:
        """The network that is enough.

        From the smallest one to the larger one of least p-value, as long as that is significant;
        of networks that are not nested the ones of least BIC count.
        """
        by_name = {fit.network.name: fit for fit in self.fits}
        ends = set()
        tested = {name for test in self.tests for name in (test.smaller, test.larger)}
        larger = {test.larger for test in self.tests}
        for begin in by_name:
            # What is larger than another is only reached from there.
            if begin in tested and begin in larger:
                continue
            name = begin
            while True:
                tests = [t for t in self.tests if t.smaller == name and t.p_value < SIGNIFICANCE]
                if not tests:
                    break
                name = min(tests, key=lambda t: (t.p_value, -t.statistic)).larger
            ends.add(name)
        return min((by_name[name] for name in ends), key=lambda fit: fit.criteria.bic)


def compare(fits: Sequence[RcFit]) -> RcComparison:
    """Likelihood-ratio tests of all nested pairs.

    Parameters
    ----------
    fits : sequence of RcFit

    Raises
    ------
    FitError
        Networks that are fitted to different readings, or two of one name.
    """
    ordered = tuple(sorted(fits, key=lambda fit: fit.parameters))
    names = [fit.network.name for fit in ordered]
    for fit in ordered[1:]:
        both = f"{fit.network.name} and {ordered[0].network.name}"
        own, first = (set(each.network.outputs) for each in (fit, ordered[0]))
        if own != first:
            raise FitError(f"{both} measure other channels: {', '.join(sorted(own ^ first))}")
        if fit.likelihood.readings != ordered[0].likelihood.readings:
            raise FitError(f"{both} are fitted to other rows: an input of one is missing there")
        if names.count(fit.network.name) > 1:
            raise FitError(f"two networks are called {fit.network.name}: give each a 'name'")
    tests = tuple(
        LikelihoodRatio(a.network.name, b.network.name, a.deviance - b.deviance,
                        b.parameters - a.parameters)
        for a in ordered for b in ordered
        if b.parameters > a.parameters and is_nested(a.network, b.network)
    )  # fmt: skip
    return RcComparison(ordered, tests)


def is_nested(small: RcNetwork, large: RcNetwork) -> bool:
    """Whether a network is a limit of a larger one: capacities to zero, conductances to 0 or ∞.

    Its nodes are there under the same names with the same sensors; each of its links is there, or
    leads through nodes that it does not have; heat goes to the same nodes, or to such nodes beside
    them. What holds in the larger one holds in it, too.

    Parameters
    ----------
    small, large : RcNetwork
    """
    own = {node.name: node.measured for node in small.nodes}
    theirs = {node.name: node.measured for node in large.nodes}
    if any(name not in theirs or theirs[name] != channel for name, channel in own.items()):
        return False
    more = set(theirs) - set(own)
    if any(theirs[name] is not None for name in more):
        return False
    held = {p.name: p.start for p in small.parameters if p.fixed}
    for p in large.parameters:
        known = p.name.split(".")[1] in own or p.name.startswith(("links.", "heat."))
        if p.fixed and known and held.get(p.name, p.start) != p.start:
            return False
        declared = any(p.name == q.name for q in small.parameters)
        if p.fixed and declared and p.name not in held:
            return False
    for link in small.links:
        if not _leads(large, _ends(small, link.ends), more):
            return False
    for each in small.heat:
        places = [h.node for h in large.heat if h.channel == each.channel]
        if not any(p == each.node or (p in more and _leads(large, (p, each.node), more))
                   for p in places):  # fmt: skip
            return False
    return True


def _ends(network: RcNetwork, ends: tuple[str, str]) -> tuple[str, str]:
    """Ends of a link, boundaries by their channels, which networks may name differently."""
    first, second = (_place(network, end) for end in ends)
    return first, second


def _place(network: RcNetwork, end: str) -> str:
    return end if network.index(end) is not None else network.boundary(end).channel or end


def _leads(network: RcNetwork, ends: tuple[str, str], through: set[str]) -> bool:
    """Whether links lead from one end to the other through some nodes alone."""
    reached, waiting = {ends[0]}, [ends[0]]
    while waiting:
        place = waiting.pop()
        for link in network.links:
            both = _ends(network, link.ends)
            if place not in both:
                continue
            other = both[1] if both[0] == place else both[0]
            if other == ends[1]:
                return True
            if other in through and other not in reached:
                reached.add(other)
                waiting.append(other)
    return False
