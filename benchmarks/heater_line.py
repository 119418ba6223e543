"""Work of ``compensate --heater`` for a line, against what waits in the dead time.

    python benchmarks/heater_line.py

One line is a sample of 0.1 s: the model goes on, the power for the next is searched, the output is
told. Both heaters act behind the same delay, which is full before the clock runs.

Prints a Markdown table: medians of 2000 lines, in ms.
"""

from __future__ import annotations

import statistics
import time

from thermaltool.control.heaters import Stabilizer
from thermaltool.effects.curve import DriveCurve
from thermaltool.model import Drive, Model, Output, Term
from thermaltool.responses.rational import Rational2

DT, LINES = 0.1, 2000
CAUSAL, HEATER, ANGLE = "Q_causal_W", "Q_stabilization_W", "phi_x_urad"


def milliseconds(samples: int, curved: bool) -> float:
    """For a line, `samples` of them in the dead time."""
    drives = tuple(Drive(channel, "zero", 0.0, (0.0, 70.0)) for channel in (CAUSAL, HEATER))
    terms = (
        Term(CAUSAL, ANGLE, Rational2(1.8, 1200.0, 0.9, 6000.0, DT * samples)),
        Term(HEATER, ANGLE, Rational2(-2.0, 900.0, -1.0, 5000.0, DT * samples)),
    )
    curve = DriveCurve(HEATER, {"level": 70.0, "c1": 0.3, "c2": 0.7})
    output = Output(ANGLE, "deflection", "first", (-200.0, 200.0))
    model = Model(drives, (output,), terms, DT, effects=(curve,) if curved else ())
    stabilizer = Stabilizer(model, HEATER, ANGLE, (0.0, 70.0), 2 * DT)
    stabilizer.start({CAUSAL: 0.0})
    for k in range(samples + 1):
        stabilizer.advance(DT, {CAUSAL: float(k % 50)}, float(k % 70))
    spent = []
    for k in range(LINES):
        begun = time.perf_counter()
        stabilizer.advance(DT, {CAUSAL: float(k % 50)}, stabilizer.power())
        stabilizer.now()
        spent.append(time.perf_counter() - begun)
    return 1e3 * statistics.median(spent)


def main() -> None:
    print("| samples in the dead time | straight, ms | with a curve, ms |")
    print("|---|---|---|")
    for samples in (0, 6, 600, 6000):
        straight, curved = (milliseconds(samples, each) for each in (False, True))
        print(f"| {samples} | {straight:.3f} | {curved:.3f} |")


if __name__ == "__main__":
    main()
