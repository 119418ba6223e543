"""Residual deflection after actuation in steps, against the error of the estimate itself.

For each LOG.DESIGN the stream's setpoints are added to the displacement that the probes of the
log saw. The estimate of the whole log at once, by another way through the code, gives the error
that an actuator without steps would leave; the residual may differ from it by `ALLOWED` at most.
The probes' own noise (0.2 µm per sample) is in both bands and not in the difference.

Prints a Markdown table; exits with 3 when a difference is larger.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from thermaltool.logs import read_log

ALLOWED = 1.0  # µm
DEFLECTIONS = {"d_x_um": "offset_x_um", "d_y_um": "offset_y_um"}


def compare(log: Path, estimate: Path, setpoints: Path) -> tuple[float, float, float]:
    """Band of the estimation error, band of the residual, largest difference of the two [µm]."""
    measured, estimated = read_log(str(log)), read_log(str(estimate))
    streamed = np.genfromtxt(setpoints, delimiter=",", names=True)
    # The last line is the safe setpoint, at the time of the one before.
    if not np.array_equal(streamed["time_s"][:-1], measured.time):
        raise SystemExit(f"{setpoints}: the clock is not that of {log}")
    error_bands, residual_bands, differences = [], [], []
    for deflection, offset in DEFLECTIONS.items():
        moved = measured.column(deflection)
        error = moved - estimated.column(deflection)
        residual = moved + streamed[offset][:-1]
        error_bands.append(np.ptp(error))
        residual_bands.append(np.ptp(residual))
        differences.append(np.max(np.abs(residual - error)))
    return max(error_bands), max(residual_bands), max(differences)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("samples", type=Path, help="folder with frame_LOG.parquet")
    parser.add_argument("results", type=Path, help="folder with LOG.DESIGN.estimate.parquet, ...")
    parser.add_argument("names", nargs="+", metavar="LOG.DESIGN")
    options = parser.parse_args()
    print("| input | design | error band µm | residual band µm | largest difference µm |")
    print("|---|---|---|---|---|")
    largest = 0.0
    for name in options.names:
        log, _, design = name.partition(".")
        error, residual, difference = compare(
            options.samples / f"frame_{log}.parquet",
            options.results / f"{name}.estimate.parquet",
            options.results / f"{name}.setpoints.csv",
        )
        print(f"| {log} | {design} | {error:.2f} | {residual:.2f} | {difference:.2f} |")
        largest = max(largest, difference)
    verdict = "holds" if largest <= ALLOWED else "DOES NOT HOLD"
    print(
        f"\nResidual within ±{ALLOWED:g} µm of the estimation error: {verdict} ({largest:.2f} µm)"
    )
    sys.exit(0 if largest <= ALLOWED else 3)


if __name__ == "__main__":
    main()
