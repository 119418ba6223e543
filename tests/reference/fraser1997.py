"""Published numbers: S. Fraser, thesis 1997, chapters 3 to 7.

Temperature (5.3, 5.8): K, a, alpha, r, r0; lengths in the source's unit, heat 1 = full scale.
Regularization (5.55): A, B, c. Deflection (6.16, 7.19): A a B b D d (E e), µm and 1/s.
"""

from __future__ import annotations

# Linear structure, measured; Q = 1 is 280 W, sampled every 0.5 s.
PAIR = {"K": 3.498, "a": 0.01565, "alpha": 0.1173, "r": 5.12, "r0": 0.12}
PAIR_REGULARIZATION = {"A": 0.00644, "B": 0.00135, "c": 0.0859}
PERIOD = 0.5

# Nonlinear structure, main source (finite elements); Q = 1 is 197.5 W.
MAIN = {"K": 3.372, "a": 3.20, "alpha": 0.000212, "r": 0.19, "r0": 0.12}
MAIN_REGULARIZATION = {"A": 5.59e-3, "B": 8.25e-6, "c": 0.290}

# Joint sources, each seen by its own probe and by the other's.
JOINT = tuple(
    {"K": 3.73, "a": a, "alpha": alpha, "r": r, "r0": 0.12}
    for a, alpha, r in (
        (0.025, 0.0841, 4.89),
        (0.025, 0.0841, 12.47),
        (0.0361, 0.0799, 6.21),
        (0.0361, 0.0799, 10.84),
    )
)


def _deflection(*values: float) -> dict[str, float]:
    return dict(zip(("A", "a", "B", "b", "D", "d", "E", "e"), values, strict=False))


LINEAR_X = _deflection(10.546, 5.90e-4, 67.08, 9.14e-4, -0.0414, 0.00435)
LINEAR_Y = _deflection(100.43, 9.09e-4, 141.96, 1.57e-3, -0.01000, 0.00903)
LINEAR_STEADY = {"x": 77.6, "y": 242.4}  # µm

MAIN_X = _deflection(-0.1695, 0.00890, -1.255, 0.00129, -0.004785, 0.0097)
MAIN_Y = _deflection(3.845, 0.0123, 2.355, 0.00142, -0.0354, 0.0338)
JOINT_1X = _deflection(0.787, 0.00971, 1.20, 0.00441, -0.0145, 0.00849)
JOINT_1Y = _deflection(-0.241, 0.00312, -6.29, 0.00462, 0.0357, 0.0123)
JOINT_2X = _deflection(-0.737, 0.0120, 1.87, 0.00289, -0.0135, 0.0077, 0.0178, 0.0191)
JOINT_2Y = _deflection(-0.111, 0.0022, -7.27, 0.00489, -0.123, 0.0157, 0.179, 0.0201)

# Regular part of the kernel and singular weight for PAIR: they nearly cancel.
PAIR_A0 = -38.42
PAIR_KERNEL_INTEGRAL = 38.82
# What a window leaves of the steady state with the printed regularization. The print says 2 % and
# 0.05 %; recomputed from the printed parameters the kernel rings and leaves this much.
TRUNCATION = {150.0: -0.95, 600.0: +0.019}
