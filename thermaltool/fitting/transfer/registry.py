"""Structures by name: a new one is a file and a line here.

Nothing is imported before a structure is used, so that the command line can list them.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from thermaltool.fitting.transfer.structure import Structure


@dataclass(frozen=True)
class StructureEntry:
    """Where a structure is.

    Attributes
    ----------
    module, class_name : str
    noise : str
        Where the noise enters, for help texts.
    """

    module: str
    class_name: str
    noise: str

    def load(self) -> type[Structure]:
        """The class."""
        module = importlib.import_module(f"thermaltool.fitting.transfer.{self.module}")
        found: type[Structure] = getattr(module, self.class_name)
        return found


STRUCTURES = {
    "oe": StructureEntry("oe", "OeStructure", "at the output"),
    "bj": StructureEntry("bj", "BjStructure", "with a model of its own"),
    "arx": StructureEntry("equation_error", "ArxStructure", "through the denominator"),
    "armax": StructureEntry("equation_error", "ArmaxStructure", "that with a moving average"),
}
# Forms in which all outputs share their poles, and how many each has at most.
MAX_MODES = {"network": 6, "subspace": 12, "lpv": 4, "bilinear": 4}
# Those that have a form in continuous time.
CONTINUOUS = {"oe": StructureEntry("continuous", "ContinuousOeStructure", "at the output")}


def described() -> str:
    """Where the noise enters in each structure, as an enumeration."""
    *others, last = (f"{entry.noise} ({name})" for name, entry in STRUCTURES.items())
    return f"{', '.join(others)}, or {last}"


def structure_of(
    name: str, noise: tuple[int, int] = (1, 1), real: bool = False, continuous: bool = False
) -> Structure:
    """A structure by its name.

    Parameters
    ----------
    name : str
        One of `STRUCTURES`, or of `CONTINUOUS`.
    noise : (int, int)
        Orders of C and D, where it has them.
    real : bool
        Real poles only.
    continuous : bool
        In continuous time.
    """
    return (CONTINUOUS if continuous else STRUCTURES)[name].load()(noise, real)
