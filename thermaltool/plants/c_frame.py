"""A C-frame with two heaters on its surface, after Mareš et al., section 3.

From print: Δ = 200 mm between the probes of x; 70 W on either heater in the calibration, which
lasts 12 h (24 h for two); the basic model leaves 24 % of the angle in power spectrum A and 37 % in
B, which the source puts down to the voltage regulators first of all.

Chosen, for no drawing and no angle of it is printed: base, column and arm of square tube, 200 mm
with a wall of 30 mm, bolted of plates (half the conduction of solid metal around the girth), so
that a calibration of 12 h is needed and ends settled; the causal heater low on the front of the
column, the stabilization heater high on its back and the stronger one. 70 W end at 301 and -309
µrad. The regulators are chosen so that a basic model is about as good as the printed one.
"""

from __future__ import annotations

from thermaltool.plants.heated import Film, HeatedPlant, Regulator, assemble, pad
from thermaltool.plants.tubes import Chain, Metal, Tube

FULL_POWER = 70.0  # [W]
CAUSAL, STABILIZATION = Regulator(FULL_POWER, 1.1, 0.5), Regulator(FULL_POWER, 1.6, 0.5)
GIRTH_CONDUCTION = 0.5  # [solid metal] around the girth: the tubes are bolted of plates


def build() -> HeatedPlant:
    """The C-frame; the chain goes from the table back, up and forward again."""
    width, wall = 0.2, 0.03
    tubes = [
        Tube((0.3, 0.0), (0.0, 0.0), width, wall, 7, square=True, around=GIRTH_CONDUCTION),
        Tube((0.0, 0.0), (0.0, 0.55), width, wall, 12, square=True, around=GIRTH_CONDUCTION),
        Tube((0.0, 0.55), (0.4, 0.55), width, wall, 9, square=True, around=GIRTH_CONDUCTION),
    ]
    chain = Chain(tubes, Metal(), foot=0.1)

    # Upwards, the left of the axis is the back.
    causal = pad(chain, 1, 2, (3, 4), 4, CAUSAL)
    stabilization = pad(chain, 1, 7, (0, 7), 9, STABILIZATION)
    probes = ((0.4, 0.45), (0.4, 0.25))
    return assemble(chain, Film(natural=4.0, steady=5.0), (causal, stabilization), probes)
