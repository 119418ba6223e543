"""A small machine and the scene that it makes, for the checks of the catalogue."""

from __future__ import annotations

import numpy as np

from thermaltool.effects.scene import Scene
from thermaltool.model import Drive, Model, Output, Term, acting_drives, relative
from thermaltool.model.span import spans
from thermaltool.record import Record
from thermaltool.responses.deflection import Deflection

PERIOD, ROWS = 5.0, 800
HEAT, AIR, PART = "Q_main_1", "T_room_degC", "T_part_degC"
BEARING, COOLANT = "Q_bearing_1", "x_coolant_1"
COLUMN, NEAR, FAR, X, Y = "T_column_degC", "dT_near_K", "dT_far_K", "d_x_um", "d_y_um"
FROZEN = slice(400, 520)


def first_order(gain, rate):
    """gain·(1 − e^(−rate t))."""
    return Deflection(gain, rate, 0.0, 1.0, 0.0, 1.0)


RESPONSES = {
    COLUMN: first_order(40.0, 1 / 600),
    NEAR: first_order(20.0, 1 / 200),
    FAR: first_order(8.0, 1 / 400),
    X: first_order(-60.0, 1 / 500),
    Y: first_order(100.0, 1 / 900),
}


def model(*effects, outputs=tuple(RESPONSES), hold="zero"):
    rest = {COLUMN: 21.5, NEAR: 0.0, FAR: 0.0, X: "first", Y: "first"}
    return Model(
        drives=(Drive(HEAT, hold, 0.0, (0.0, 1.0)),),
        outputs=tuple(
            Output(o, "deflection" if o in (X, Y) else "sensor", rest[o], (-100.0, 100.0))
            for o in outputs
        ),
        terms=tuple(Term(HEAT, o, RESPONSES[o]) for o in outputs),
        sample_period=PERIOD,
        effects=effects,
    )


def columns(seed=0, extra=(AIR, PART, BEARING, COOLANT), bipolar=True, frozen=True):
    """A log of the machine itself, with noise and a stretch in which one reading is frozen."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(ROWS)
    low = -0.6 if bipolar else 0.2
    duty = np.repeat([0.0, 1.0, 0.3, low, 0.0, 0.8, low, 0.5], ROWS // 8)
    beside = {
        AIR: 20 + 1.5 * np.sin(2 * np.pi * time / 3000),
        PART: 20 + time / 2000,
        BEARING: ((time // 700) % 2).astype(float),
        COOLANT: ((time // 1100) % 2).astype(float),
    }
    result = {HEAT: duty, **{name: beside[name] for name in extra}}
    simulated = model().simulate(Record(time, result))
    for o in model().outputs:
        rest = 5.0 if o.offset == "first" else o.offset
        result[o.channel] = simulated[o.channel] + rest + 0.02 * rng.normal(size=ROWS)
    if frozen:
        result[FAR][FROZEN] = result[FAR][FROZEN.start]
    return time, result


def scene(*logs):
    """What a catalogue sees of logs of (time, columns)."""
    machine = model()
    logs = tuple(Record(t, c, digest=name) for name, (t, c) in zip("pqr", logs, strict=False))
    simulated = tuple(machine.simulate(log) for log in logs)
    outputs = tuple(o.channel for o in machine.outputs)
    known = {HEAT, *outputs}
    return Scene(
        logs=logs,
        drives=(HEAT,),
        outputs=outputs,
        extra=tuple(c for c in logs[0].columns if c not in known),
        unanswered={},
        spans=spans(machine),
        acting_drives=tuple(acting_drives(machine, (), log) for log in logs),
        simulated=simulated,
        residual=tuple(
            {o.channel: relative(log.columns[o.channel], o.offset) - y[o.channel]
             for o in machine.outputs}
            for log, y in zip(logs, simulated, strict=True)
        ),
        noise=dict.fromkeys(outputs, 0.02),
        slowest={o: RESPONSES[o].slowest() for o in outputs},
        bodies={o: RESPONSES[o].slowest() for o in outputs},
    )  # fmt: skip
