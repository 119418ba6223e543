"""Machines of other physics than the tool's frame, made of numpy alone."""

from machines.foreign.bench import bench
from machines.foreign.bonder import bonder
from machines.foreign.chain import chain
from machines.foreign.mill import mill
from machines.foreign.mirror import mirror
from machines.foreign.motor import motor
from machines.foreign.plate import plate
from machines.foreign.printer import printer
from machines.foreign.rod import rod
from machines.foreign.screw import screw
from machines.foreign.slab import slab
from machines.foreign.spindle import spindle
from machines.foreign.tank import tank

# From a generator to a machine of drawn parameters. New ones last: draws go by the order.
PLANTS = {
    "rod": rod,
    "printer": printer,
    "plate": plate,
    "slab": slab,
    "chain": chain,
    "spindle": spindle,
    "mirror": mirror,
    "tank": tank,
    "mill": mill,
    "screw": screw,
    "bench": bench,
    "bonder": bonder,
    "motor": motor,
}
