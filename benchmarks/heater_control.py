"""What two control heaters on the simulated frame can hold at best: a Markdown table.

``python benchmarks/heater_control.py``. The heats are found offline, as a linear program, with the
disturbance known beforehand and the plant for its own model: the least band of the worse of x and
y over the time given, each heat between zero and full power, held for 1/80 of that time. Beside it
the bands that Fraser (1997), section 8.8, measured with his controllers, and 60 % of them.
"""

from __future__ import annotations

import os
import time

# One core; before numpy loads.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from thermaltool.plants.controlled_frame import ControlledFrame, controlled_frame
from thermaltool.plants.frame import OUTPUTS

Array = NDArray[np.float64]
# Step of heat [full scale] to the band that the source measured [um]; 32 um is a peak, saturated.
PUBLISHED = {0.5: 6.0, 1.0: 9.5, 1.5: 32.0}
DURATIONS = (600.0, 1200.0, 2400.0, 3600.0)  # [s]
HELD = 80  # stretches over which a heat is constant
FULL = (250.0, 500.0)  # [W]
NO_AXES = np.zeros(2)
DEFLECTIONS = [OUTPUTS.index("d_x_um"), OUTPUTS.index("d_y_um")]


def least_band(
    frame: ControlledFrame,
    levels: float | Array,
    duration: float,
    stuck: tuple[int, float, float] | None = None,
    axes: Array = NO_AXES,
) -> tuple[float, float]:
    """Band without and with the best heats, zero included [um].

    Parameters
    ----------
    frame : ControlledFrame
    levels : float, or ndarray, shape (HELD,)
        The disturbance in each stretch, or a step at time 0 [full scale].
    duration : float [s]
    stuck : (int, float [full scale], float [s]), optional
        A heater, what it gives whatever is set, and from when.
    axes : ndarray, shape (2,) [um]
        What an NC axis takes of x and of y, up and down; the band is of what is left.
    """
    time_of, effect, free = _course(frame, levels, duration)
    heat = np.tile([0.0, 1.0], (HELD, 2, 1))
    if stuck is not None:
        heater, given, since = stuck
        heat[time_of > since, heater] = given
    # Unknown beside heats and offsets: lower and upper edge of x and y, and the band's width W.
    outputs, nothing = np.tile(np.eye(2), (HELD, 1)), np.zeros((2 * HELD, 2))
    no_width, moved = np.zeros((2 * HELD, 1)), 4 * HELD
    effect = np.hstack([effect, np.eye(2 * HELD)])
    above = np.hstack([effect, nothing, -outputs, no_width])
    below = np.hstack([-effect, outputs, nothing, no_width])
    width = np.hstack([np.zeros((2, moved)), -np.eye(2), np.eye(2), -np.ones((2, 1))])
    found = linprog(
        np.append(np.zeros(moved + 4), 1.0),
        A_ub=np.vstack([above, below, width]),
        b_ub=np.concatenate([-free, free, np.zeros(2)]),
        bounds=[*heat.reshape(-1, 2), *[(-reach, reach) for reach in axes] * HELD]
        + [(None, 0.0)] * 2
        + [(0.0, None)] * 3,
        method="highs",
    )
    ends = np.vstack([np.zeros(2), free.reshape(HELD, 2)])
    return float(np.ptp(ends, axis=0).max()), float(found.fun)


def least_share(frame: ControlledFrame, level: float, bands: dict[float, float]) -> float:
    """The least part of given bands that one course of heats keeps, whenever the work ends.

    Parameters
    ----------
    frame : ControlledFrame
    level : float
        A step at time 0, known beforehand [full scale].
    bands : mapping of duration [s] to band [um]
        From time 0 to each of these.
    """
    time_of, effect, free = _course(frame, level, max(bands))
    heats = 2 * HELD
    rows, bounds = [], []
    for k, (duration, band) in enumerate(bands.items()):
        # Unknown: the heats, lower and upper edge of each axis in each duration, and the share.
        within = np.repeat(time_of <= duration * (1 + 1e-9), 2)
        edges = np.zeros((2, heats, 4 * len(bands)))
        edges[:, np.arange(heats), 4 * k + np.arange(heats) % 2] = [[1.0], [0.0]]
        edges[1, np.arange(heats), 4 * k + 2 + np.arange(heats) % 2] = -1.0
        none = np.zeros((heats, 1))
        rows += [np.hstack([-effect, edges[0], none])[within],
                 np.hstack([effect, edges[1], none])[within]]  # fmt: skip
        bounds += [free[within], -free[within]]
        width = np.zeros((2, heats + 4 * len(bands) + 1))
        width[[0, 1], heats + 4 * k + np.arange(2)] = -1.0
        width[[0, 1], heats + 4 * k + 2 + np.arange(2)] = 1.0
        width[:, -1] = -band
        rows.append(width)
        bounds.append(np.zeros(2))
    found = linprog(
        np.append(np.zeros(heats + 4 * len(bands)), 1.0),
        A_ub=np.vstack(rows),
        b_ub=np.concatenate(bounds),
        bounds=[(0.0, 1.0)] * heats + [*[(None, 0.0)] * 2, *[(0.0, None)] * 2] * len(bands)
        + [(0.0, None)],
        method="highs",
    )  # fmt: skip
    return float(found.fun)


def _course(
    frame: ControlledFrame, levels: float | Array, duration: float
) -> tuple[Array, Array, Array]:
    """Ends of the stretches, what heats in each do to x and y then, and both without control."""
    time_of = duration / HELD * np.arange(1, HELD + 1)
    steps = frame.step_responses(time_of)[:, DEFLECTIONS, :]
    pulses = np.diff(steps, axis=0, prepend=0.0)
    acting = np.zeros((HELD, 2, HELD, 2))
    for k in range(HELD):
        acting[k, :, : k + 1, :] = pulses[k::-1, :, 1:].transpose(1, 0, 2)
    effect = acting.reshape(2 * HELD, 2 * HELD)
    course = np.broadcast_to(np.asarray(levels, float), (HELD,))
    free = np.array([course[: k + 1] @ pulses[k::-1, :, 0] for k in range(HELD)]).ravel()
    return time_of, effect, free


def main() -> None:
    began = time.perf_counter()
    print(
        "| full power W | step | over s | without um | least band um | published um | 60 % um | |"
    )
    print("|---" * 8 + "|")
    for full in FULL:
        frame = controlled_frame(full=full)
        for level, published in PUBLISHED.items():
            for duration in DURATIONS:
                free, band = least_band(frame, level, duration)
                within = "yes" if band <= 0.6 * published else "no"
                print(
                    f"| {full:g} | {level:g} | {duration:g} | {free:.0f} | {band:.1f} | "
                    f"{published:g} | {0.6 * published:.1f} | {within} |",
                    flush=True,
                )
    print(f"\n{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
