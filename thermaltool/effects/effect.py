"""What every physical cause has in common: parameters, the physics, and trial sizes.

An effect acts at one place of the model: on a drive before its terms (`Effect.drive`), on the
rate at which heat is lost (`Effect.loss`) or at which everything goes (`Effect.pace`), on responses
for good (`Effect.response`), or on outputs (`Effect.output`, `Effect.reading` for one). All are the
identity unless a cause says so: it is one file that overrides what it changes, lists its
parameters, and says in `probes` at which places and sizes it is worth a trial. A causal one takes a
record whole or, with `Memory`, by rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from thermaltool.effects.scene import Scene
from thermaltool.errors import ModelError
from thermaltool.record import Record
from thermaltool.responses import Response
from thermaltool.units import parse_channel

Float = NDArray[np.float64]
# Outputs by channel, relative to rest, each of shape (n,).
Outputs = Mapping[str, Float]
# What an effect keeps of the rows that have passed, by name; None where it gets the whole record.
Memory = dict[str, Any] | None
Side = Literal["drive", "state", "source", "structure", "sensor", "wiring"]

STILL = Record(np.zeros(1), {})  # for effects that look at the value of the moment alone
NOBODY_LOGGED = 0.05  # odds of an accident of this very record, or of what nobody has logged
# The order in which outputs pass: physics first, then what reads it, then who it is called.
SIDES: tuple[Side, ...] = ("drive", "state", "source", "structure", "sensor", "wiring")


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes
    ----------
    unit : str
        A unit, in which ``{channel}`` and ``{output}`` stand for those of the channels.
    neutral, low, high : float
        The value at which the effect is not there (of a place or a time: any); plausible ones.
    linear, log : bool
        Outputs are linear in it while the others stand still; positive, searched by its logarithm.
    fixed : bool
        Taken from the situation, not fitted.
    place : bool
        Where something is in the range of the channel, not how strong it is.
    """

    unit: str
    neutral: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    linear: bool = False
    log: bool = False
    fixed: bool = False
    place: bool = False


def needed(record: Record, channel: str) -> Float:
    """Samples of a channel that an effect reads, shape (n,).

    Parameters
    ----------
    record : Record
    channel : str

    Raises
    ------
    ModelError
        It is not in the record.
    """
    if channel not in record.columns:
        raise ModelError(f"an effect of the model needs {channel}, which is not in the log")
    return record.columns[channel]


def reference_of(name: str) -> tuple[str, str | None]:
    """``gain[d_x_um]`` is the parameter ``gain`` of the output ``d_x_um``.

    Parameters
    ----------
    name : str
    """
    base, bracket, rest = name.partition("[")
    return base, rest.removesuffix("]") if bracket else None


@dataclass(frozen=True)
class Effect:
    """One cause at one place, with its parameters.

    Attributes
    ----------
    channel : str
        The drive, output or extra channel at which it acts; what a user is told.
    parameters : mapping of str to float
        ``name`` or, for one value per output, ``name[output]``.
    log : str or None
        The only log in which it acts (an accident of that day); None for every log.
    covariance : ndarray or None
        Of the parameters, in their order.
    partner : str or None
        A second channel that it takes to say what happened (the other one of a pair).
    """

    channel: str
    parameters: Mapping[str, float]
    log: str | None = None
    covariance: Float | None = field(default=None, compare=False)
    partner: str | None = None

    name: ClassVar[str]
    side: ClassVar[Side]
    explanation: ClassVar[str]
    # What a technician can do, with places for {channel}, {output}, {partner}, {moves} and the
    # parameters (`thermaltool.diagnosis.action`); where nothing is logged; where a sensor is read;
    # where it has no partner.
    action: ClassVar[str]
    action_unlogged: ClassVar[str] = ""
    action_measured: ClassVar[str] = ""
    action_alone: ClassVar[str] = ""
    signature: ClassVar[str]
    source: ClassVar[str]
    known: ClassVar[Mapping[str, Parameter]]
    further: ClassVar[tuple[str, ...]] = ()  # Names of fields of a class that a file holds, too.
    event: ClassVar[bool] = False  # Whether it belongs to the log in which it was seen alone.
    at_start: ClassVar[bool] = False  # Whether it is over soon after the first row.
    bends: ClassVar[bool] = False  # Whether outputs are no longer in proportion to drives.
    defect: ClassVar[bool] = False  # Whether it is none of how such a machine works.
    stands: ClassVar[bool] = False  # Whether it moves outputs with all amplitudes neutral, too.
    memoryless: ClassVar[bool] = False  # Whether it looks at the value of the moment alone.
    # Whether `drive`, `loss` and `output` give for rows one after another, with a memory that goes
    # from each to the next, what they give for the whole record. What is not is refused by name.
    causal: ClassVar[bool] = False

    def drive(self, record: Record, u: Float, memory: Memory = None) -> Float:
        """What acts in place of the drive `u`, both relative to its reference.

        Parameters
        ----------
        record : Record
            The whole record or, with a memory, the rows that follow the last call.
        u : ndarray, shape (n,)
        memory : dict, optional
            Empty before the first row; changed in place.
        """
        return u

    def loss(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        """By how much every rate of decay rises at each sample [1/s]; None for not at all.

        Parameters
        ----------
        record, memory : as for `drive`
        outputs : mapping of channel to ndarray, shape (n,)
            Relative to rest.
        """
        return None

    def pace(self, record: Record, outputs: Outputs, memory: Memory = None) -> Float | None:
        """By what factor the machine's own time goes faster at each sample; None for not at all.

        Parameters
        ----------
        record, outputs, memory : as for `loss`
        """
        return None

    def response(self, response: Response, drive: str, output: str) -> Response:
        """What answers in place of a response of the model.

        Parameters
        ----------
        response : Response
        drive, output : str
            Of which and in which it is.
        """
        return response

    def output(self, name: str, outputs: Outputs, record: Record, memory: Memory = None) -> Float:
        """What is read in place of ``outputs[name]``, relative to rest: `reading` at `channel`.

        Parameters
        ----------
        name : str
        outputs : mapping of channel to ndarray, shape (n,)
        record, memory : as for `drive`
            Every output has a memory of its own.
        """
        y = outputs[name]
        return self.reading(y, record, memory) if name == self.channel else y

    def read(self, outputs: Outputs, record: Record) -> Outputs:
        """What is read in place of all outputs of a whole record.

        Parameters
        ----------
        outputs, record : as for `output`
        """
        return {name: self.output(name, outputs, record) for name in outputs}

    def reading(self, y: Float, record: Record, memory: Memory = None) -> Float:
        """What is read in place of the output `y` at `channel`.

        Parameters
        ----------
        y : ndarray, shape (n,)
        record, memory : as for `drive`
        """
        return y

    # What a stream asks for, in which readings come in and drives are unknown:
    def undone(self, values: Float) -> Float | None:
        """The drive behind what acts, or the truth behind a reading; NaN where there is none.

        None for a cause that no function of the moment takes back.

        Parameters
        ----------
        values : ndarray, shape (n,)
        """
        return None

    def paths(self, output: str) -> tuple[tuple[float, float], ...]:
        """Gains and time constants [s] of the lags from `channel` to an output."""
        return ()

    @property
    def lag(self) -> float:
        """Time constant with which a reading follows the truth [s]; 0 for at once."""
        return 0.0

    def lags(self, output: str) -> tuple[float, ...]:
        """Time constants [s] behind which an output follows, and that are no modes of the model."""
        own = tuple(tau for _, tau in self.paths(output))
        return (*own, self.lag) if self.channel == output else own

    @property
    def dead_time(self) -> float:
        """Time by which the drive acts later than it is logged [s]; below zero, earlier."""
        return 0.0

    @property
    def course(self) -> float:
        """Its time constant or period, the longer one [s]; 0 where it has neither."""
        return max(self.parameters.get(name, 0.0) for name in ("time_constant", "period"))

    @classmethod
    def probes(cls, scene: Scene) -> Iterator[Effect]:
        """The effect at every place and, for what is searched, at every size worth a trial."""
        yield from ()

    def plausible(self, scene: Scene) -> bool:
        """Whether its parameters are what a machine may have; judged before it is believed."""
        known = ((self.parameter(name), value) for name, value in self.parameters.items())
        return all(each.low <= value <= each.high for each, value in known)

    def finer(self) -> Effect | None:
        """The same cause with one more parameter to search, where that is worth a trial."""
        return None

    @property
    def odds(self) -> float:
        """How common it is beside a property of the machine, before any log is seen."""
        if self.event or not self.channel:
            return NOBODY_LOGGED
        return 0.2 if self.defect or self.side in ("sensor", "wiring") else 1.0

    def odds_alone(self, output: str | None) -> float:
        """How often it moves one output alone for sure, beside several; 0 where it never does.

        Parameters
        ----------
        output : str or None
            The one; None where it moves none for sure.
        """
        return 1.0

    @property
    def known_range(self) -> tuple[float, float] | None:
        """Values of the channel between which it is known; None for any."""
        return None

    def begins_at_rest(self, scene: Scene) -> bool:
        """Whether only a machine that begins at rest tells it from another form.

        Parameters
        ----------
        scene : Scene
        """
        return False

    @property
    def responds(self) -> bool:
        """Whether responses of the model are others for good."""
        return type(self).response is not Effect.response

    @property
    def varies(self) -> bool:
        """Whether the rates at which the machine goes change along a log."""
        own = type(self)
        return own.loss is not Effect.loss or own.pace is not Effect.pace

    @property
    def joins(self) -> bool:
        """Whether what it makes of an output goes by other outputs."""
        return self.side in ("state", "wiring")

    def needs(self) -> tuple[str, ...]:
        """Channels that a log must hold beside the drives."""
        return ()

    def parameter(self, name: str) -> Parameter:
        """What is known of a parameter: unit, bounds, how it enters.

        Parameters
        ----------
        name : str
            With or without its output in brackets.
        """
        return self.known[reference_of(name)[0]]

    def linear(self) -> tuple[str, ...]:
        """Names of the parameters that enter linearly."""
        return tuple(n for n in self.parameters if self.parameter(n).linear)

    def searched(self) -> tuple[str, ...]:
        """Names of those that do not, and are fitted."""
        known = self.parameter
        return tuple(n for n in self.parameters if not (known(n).linear or known(n).fixed))

    def unit(self, name: str) -> str:
        """Unit of a parameter."""
        base, output = reference_of(name)
        own = parse_channel(self.channel).unit if self.channel else "1"
        other = parse_channel(output).unit if output else own
        return self.known[base].unit.format(channel=own, output=other)

    def changed(self, values: Mapping[str, float]) -> Effect:
        """The same effect with other values of some parameters.

        Parameters
        ----------
        values : mapping of name to float
        """
        return replace(self, parameters={**self.parameters, **values}, covariance=None)

    def without(self, names: tuple[str, ...]) -> Effect:
        """The effect with fewer parameters (of outputs that it does not reach).

        Where it was told by such an output, it is told by one that stays.

        Parameters
        ----------
        names : tuple of str
        """
        kept = {k: v for k, v in self.parameters.items() if k not in names}
        stay = [output for k in kept if (output := reference_of(k)[1])]
        gone = self.channel in {reference_of(k)[1] for k in names} - set(stay)
        channel = stay[0] if gone and stay and not self.stands else self.channel
        return replace(self, channel=channel, parameters=kept, covariance=None)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        covariance = None if self.covariance is None else np.asarray(self.covariance).tolist()
        further = {name: value for name in self.further if (value := getattr(self, name))}
        return {
            "name": self.name,
            "channel": self.channel,
            "parameters": dict(self.parameters),
            "units": {name: self.unit(name) for name in self.parameters},
            "covariance": covariance,
            "covariance_names": list(self.parameters),
            "log": self.log,
            **({} if self.partner is None else {"partner": self.partner}),
            **further,
        }
