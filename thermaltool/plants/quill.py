"""A closed quill with two heaters on its surface, after Mareš et al., section 2.2.

From print: Δ = 100 mm between the probes of x; 90 W on the causal heater in the calibration; the
run of figure 4 without compensation reaches 9e-5 rad and 60 µm along z.

Chosen, for no drawing is printed: a steel tube of 200 mm with a wall of 65 mm, clamped at its upper
end, its tool pointing down; heaters on opposite sides, the stabilization heater nearer to the tool
and the stronger one, so that it can answer 90 W on the causal one. Length, wall and clamp are such
that 90 W end at the printed figures (91 µrad, 60 µm).
"""

from __future__ import annotations

from thermaltool.plants.heated import Film, HeatedPlant, Regulator, assemble, pad
from thermaltool.plants.tubes import Chain, Metal, Tube

FULL_POWER = 90.0  # [W]
CAUSAL, STABILIZATION = Regulator(FULL_POWER, 1.2, 0.3), Regulator(FULL_POWER, 1.5, 0.3)


def build() -> HeatedPlant:
    """The quill."""
    length, segments = 0.45, 12
    chain = Chain([Tube((0.0, 0.0), (0.0, -length), 0.2, 0.065, segments)], Metal(), foot=0.06)

    causal = pad(chain, 0, 3, (0, 7), 5, CAUSAL)
    stabilization = pad(chain, 0, 6, (3, 4), 8, STABILIZATION)
    probes = ((0.0, -length - 0.05), (0.0, -length - 0.15))
    return assemble(chain, Film(natural=4.0, steady=6.0), (causal, stabilization), probes)
