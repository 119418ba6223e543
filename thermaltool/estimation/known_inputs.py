"""Known inputs, read beside the sensors: measured drives, and sources that are logged.

What they do to a sensor is subtracted from its reading before the estimator, what they do to a
deflection is added behind it; each path has its own state, so that the whole is again one linear
recursion. Where every drive is measured nothing is left to estimate: that is feedforward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from thermaltool.documents import is_place
from thermaltool.effects.band import ScheduleBand, load_band
from thermaltool.errors import ModelError
from thermaltool.estimation.linear_estimator import LinearEstimator
from thermaltool.estimation.state_space import StateSpace
from thermaltool.responses.delay import load_modes
from thermaltool.responses.modes import Float, Hold, Modes
from thermaltool.responses.parallel import InputPath, parallel, settled_state
from thermaltool.responses.recursion import Recursion
from thermaltool.responses.sample_clock import uniform_spans
from thermaltool.units import Reference, source_rest

if TYPE_CHECKING:
    from thermaltool.estimation.estimator import Estimator

Role = Literal["drive", "source", "state", "contact"]

# The machine is cold where its first readings are nearer to the model's zero than to equilibrium
# with what is measured, by this factor [1].
MAX_COLD = 0.5


@dataclass(frozen=True)
class KnownInput:
    """A known input: a column that is read beside the sensors.

    Attributes
    ----------
    channel : str
    hold : "zero" or "first"
    role : "drive", "source", "state" or "contact"
        A drive of the model, relative to its reference; the channel of a source, relative to its
        rest; a state on which the loss of heat or a schedule depends, as it is; an output by
        which a joint bends others, relative to rest.
    band : ScheduleBand or None
        Of a drive: only this level's share of it.
    rest : float or "first"
        Of a source: the value at which it adds nothing, or its first one.
    """

    channel: str
    hold: Hold
    role: Role
    band: ScheduleBand | None = None
    rest: Reference = "first"

    def document(self) -> dict[str, Any]:
        """As JSON."""
        band = {} if self.band is None else {"band": self.band.document()}
        rest = {"rest": self.rest} if self.role == "source" else {}
        return {"channel": self.channel, "hold": self.hold, "role": self.role, **band, **rest}


@dataclass(frozen=True, eq=False)
class Feedforward(LinearEstimator):
    """Nothing to estimate: deflections follow from known columns alone.

    Attributes
    ----------
    outputs : tuple of str
        The deflections, then `states`.
    states : tuple of str
        Outputs by which the loss of heat goes, followed for that.
    """

    outputs: tuple[str, ...]
    states: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()

    @property
    def estimates(self) -> tuple[str, ...]:
        """All outputs."""
        return self.outputs

    def _build(self, dt: float) -> Recursion:
        none = np.zeros((0, 0))
        return Recursion(none, none, none, np.zeros((len(self.outputs), 0)))

    def document(self) -> dict[str, Any]:
        """As JSON."""
        states, outputs = list(self.states), list(self.outputs)
        told = {"states": states} if states else {}
        return {"form": "feedforward", "sensors": [], "drives": [], "outputs": outputs, **told}


@dataclass(frozen=True, eq=False)
class KnownInputEstimator(LinearEstimator):
    """An estimator that reads known inputs too.

    Attributes
    ----------
    inner : Estimator
    known : tuple of KnownInput
    to_sensors, to_outputs : tuple of (int, int, Modes or float)
        Paths from known inputs to sensors of `inner`, and to deflections.
    """

    inner: Estimator
    known: tuple[KnownInput, ...]
    to_sensors: tuple[InputPath, ...]
    to_outputs: tuple[InputPath, ...]

    @property
    def sensors(self) -> tuple[str, ...]:
        """All columns that are read, the sensors first."""
        return (*self.inner.sensors, *(k.channel for k in self.known))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Deflections that are estimated."""
        return self.inner.outputs

    @property
    def estimates(self) -> tuple[str, ...]:
        """Those of `inner`."""
        return self.inner.estimates

    @property
    def measured(self) -> tuple[bool, ...]:
        """Which known inputs are measured drives, whose first values a machine at rest has."""
        return tuple(k.role == "drive" and k.hold == "first" for k in self.known)

    def _build(self, dt: float) -> Recursion:
        """x ← F x + G0 (r − S ξ) + G1 (r⁺ − S ξ⁺), y = C x + D ξ, ξ the states of the paths."""
        inner = self.inner.recursion(dt)
        paths, S, D = self._paths(dt)
        F, below = inner.F, np.zeros((len(paths.F), inner.G0.shape[1]))
        side = -inner.G0 @ S - inner.G1 @ S @ paths.F
        passed = inner.G1 @ S
        return Recursion(
            np.block([[F, side], [np.zeros((len(paths.F), len(F))), paths.F]]),
            np.block([[inner.G0, -passed @ paths.G0], [below, paths.G0]]),
            np.block([[inner.G1, -passed @ paths.G1], [below, paths.G1]]),
            np.hstack([inner.C, D]),
        )

    def start(self, dt: float, readings: Float, settled: bool = False) -> Float:
        """State at the first readings, shape (n,): at rest in what is measured, or settled.

        A machine at rest has the temperature of its surroundings: the paths of measured drives
        begin in equilibrium with their first values, unless the sensors say otherwise.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (n_columns,)
        settled : bool
            All drives, heats too, have stood at the first readings for long.
        """
        if settled:
            return super().start(dt, readings, settled)
        inner = self.inner.recursion(dt)
        return np.concatenate([np.zeros(len(inner.F)), self.first_paths(dt, readings)])

    def at_rest(self, dt: float, readings: Float) -> Float:
        """What the sensors of a machine at rest read; see `LinearEstimator.at_rest`."""
        return self._paths(dt)[1] @ self.first_paths(dt, readings)

    def first_paths(self, dt: float, readings: Float, settled: bool = False) -> Float:
        """State of the paths at the first readings, shape (n,).

        In equilibrium with the measured drives; at rest where the sensors are much nearer to that:
        a motor is hot, and the machine behind it still cold.

        Parameters
        ----------
        dt : float [s]
        readings : ndarray, shape (n_columns,)
            A sensor's may be NaN.
        settled : bool
            In equilibrium with all known inputs.
        """
        sensors = len(self.inner.sensors)
        values = np.where(settled or np.array(self.measured), readings[sensors:], np.nan)
        holds = [k.hold for k in self.known]
        paths = [*self.to_sensors, *self.to_outputs]
        state = settled_state(paths, holds, values, dt)
        read = np.isfinite(readings[:sensors])
        foretold = (self._paths(dt)[1] @ state)[read]
        cold, warm = (
            float(np.linalg.norm(readings[:sensors][read] - each)) for each in (0.0, foretold)
        )
        is_cold = not settled and cold < MAX_COLD * warm
        return np.zeros(len(state)) if is_cold else state

    def contributions(
        self, time: Float, columns: Float, settled: bool = False
    ) -> tuple[Float, Float]:
        """What known inputs add to the sensors, and to the estimates, of a whole record.

        Parameters
        ----------
        time : ndarray, shape (n,) [s], increasing
        columns : ndarray, shape (n, n_columns)
        settled : bool
            See `start`.

        Returns
        -------
        to_sensors : ndarray, shape (n, n_sensors)
        to_estimates : ndarray, shape (n, n_estimates)
        """
        sensors = len(self.inner.sensors)
        out, x = np.zeros((len(time), sensors + len(self.estimates))), None
        for rows, dt in uniform_spans(time):
            if x is None:
                x = self.first_paths(dt, columns[0], settled)
            out[rows], x = self._paths(dt)[0].run(columns[rows, sensors:], x)
        return out[:, :sensors], out[:, sensors:]

    def expected(self, space: StateSpace, dt: float, x: Float, before: Float, now: Float) -> Float:
        """What the sensors of a Kalman filter are foretold to read after a sample.

        Parameters
        ----------
        space : StateSpace
            Of `inner`, for this sample.
        dt : float [s]
        x : ndarray, shape (n,)
            State at the sample before.
        before, now : ndarray, shape (number of sensors,)
            Readings; of `now` the known columns alone count.

        Returns
        -------
        ndarray, shape (number of sensors of `inner`,)
        """
        paths, S, _ = self._paths(dt)
        states, sensors = len(space.F), len(self.inner.sensors)
        behind = paths.F @ x[states:] + paths.G0 @ before[sensors:] + paths.G1 @ now[sensors:]
        return np.asarray(space.H @ space.F @ x[:states] + S @ behind)

    def _paths(self, dt: float) -> tuple[Recursion, Float, Float]:
        """Recursion of all paths side by side, and what sensors and estimates see of it."""
        sensors, estimates = len(self.inner.sensors), len(self.estimates)
        first_output = sensors + estimates - len(self.outputs)
        behind = [(first_output + to, source, path) for to, source, path in self.to_outputs]
        holds = [k.hold for k in self.known]
        paths = parallel([*self.to_sensors, *behind], holds, sensors + estimates, dt)
        return paths, paths.C[:sensors], paths.C[sensors:]

    def document(self) -> dict[str, Any]:
        """As JSON: the document of `inner`, and ``known``."""
        return {
            **self.inner.document(),
            "known": {
                "columns": [k.document() for k in self.known],
                "to_sensors": [_path_document(path) for path in self.to_sensors],
                "to_outputs": [_path_document(path) for path in self.to_outputs],
            },
        }  # fmt: skip


def _path_document(path: InputPath) -> dict[str, Any]:
    target, source, response = path
    how = {"modes": response.document()} if isinstance(response, Modes) else {"gain": response}
    return {"to": target, "from": source, **how}


def _rest_of(column: dict[str, Any]) -> Reference:
    """What a column of a design counts from.

    Raises
    ------
    ModelError
        A source that counted from its first value, and now from 0.
    """
    rest = column.get("rest")
    if rest is None and column["role"] == "source" and source_rest(column["channel"]) != "first":
        raise ModelError(
            f"the source {column['channel']} counts from 0 now: run thermaltool regularize again"
        )
    return "first" if rest in (None, "first") else float(rest)


def load_known_inputs(inner: Estimator, document: dict[str, Any]) -> KnownInputEstimator:
    """`inner` with the known inputs that its design lists.

    Parameters
    ----------
    inner : Estimator
    document : dict
        The part "known" of a design.

    Raises
    ------
    ModelError, KeyError, TypeError, ValueError
        A part missing or not sound.
    """
    known = tuple(
        KnownInput(
            k["channel"],
            k["hold"],
            k["role"],
            load_band(k.get("band")),
            _rest_of(k),
        )
        for k in document["columns"]
    )
    for k in known:
        if k.hold not in get_args(Hold) or k.role not in get_args(Role):
            raise ModelError(f"a known column {k.channel} of hold {k.hold!r}, role {k.role!r}")

    def paths(documents: list[dict[str, Any]], targets: Sequence[str]) -> tuple[InputPath, ...]:
        found: list[InputPath] = []
        for d in documents:
            if not (is_place(d["to"], len(targets)) and is_place(d["from"], len(known))):
                raise ModelError(f"a path from {d['from']!r} to {d['to']!r}, which are not there")
            gain = None if "modes" in d else float(d["gain"])
            if gain is not None and not np.isfinite(gain):
                raise ModelError(f"a gain that cannot be {gain:g}")
            response = load_modes(d["modes"]) if gain is None else gain
            found.append((d["to"], d["from"], response))
        return tuple(found)

    to_sensors = paths(document["to_sensors"], inner.sensors)
    return KnownInputEstimator(
        inner, known, to_sensors, paths(document["to_outputs"], inner.outputs)
    )
