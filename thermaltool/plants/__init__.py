"""Simulated machines that write test logs. They share no code with the models they judge."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# Options of every plant beside those that `Offer.options` names.
COMMON = frozenset({"duration", "seed"})
_ROOM = frozenset({"shape", "start", "dt", "ambient", "clean"})
_HEATED = _ROOM | {"heater", "power", "swing"}


@dataclass(frozen=True)
class Offer:
    """A plant as ``thermaltool plant`` offers it.

    Attributes
    ----------
    module : str
        Its `build()` returns the plant; `thermaltool.plants.run` makes logs of it. Both are
        imported on use.
    options : frozenset of str
        What it takes beside `COMMON`.
    inputs : tuple of str
        Shapes of its input that have a name.
    usual : mapping of str to float
        Options where none is given: duration, start and dt [s].
    """

    module: str
    options: frozenset[str]
    inputs: tuple[str, ...]
    usual: Mapping[str, float]


_DUTIES = ("step", "A", "B", "quick", "mixed")
_HALF_A_DAY = {"duration": 43200.0, "start": 1800.0, "dt": 60.0}

PLANTS = {
    "frame": Offer(
        "frame",
        _ROOM | {"level", "sigma", "drift", "drift_time", "sigma_d"},
        ("step", "idle", "triangle", "duty"),
        {"duration": 9000.0, "start": 60.0, "dt": 0.5},
    ),
    "quill": Offer("quill", _HEATED, _DUTIES, _HALF_A_DAY),
    "c-frame": Offer("c_frame", _HEATED, _DUTIES, _HALF_A_DAY),
    "knee-mill": Offer(
        "knee_mill",
        _ROOM | {"level", "sigma", "drift", "drift_time", "sigma_d", "load"},
        ("step", "idle", "triangle", "duty"),
        {"duration": 9000.0, "start": 60.0, "dt": 10.0},
    ),
    "boring-bar": Offer(
        "boring_bar", frozenset({"speed", "part", "commands"}), (), {"duration": 4.0}
    ),
}


class SettingError(ValueError):
    """What a plant cannot be set to; `option` is the one to blame, where it is one."""

    def __init__(self, message: str, option: str | None = None) -> None:
        super().__init__(message)
        self.option = option


def build(name: str) -> Any:
    """Assemble the plant called `name`, a key of `PLANTS`."""
    return importlib.import_module(f"{__name__}.{PLANTS[name].module}").build()
