"""Bodies of the tests: the spindle rod of Zhu, Ni, Shih 2008, Table 1, and a block."""

from __future__ import annotations

import copy

import pytest

from thermaltool.placement.declaration import load_body

ROD = {
    "format": "thermaltool-body",
    "version": 1,
    "mesh": {"rod": {"length": 1.0, "area": 0.0314, "elements": 22}},
    "materials": {
        "steel": {
            "conductivity": 60.5, "density": 7800.0, "specific_heat": 434.0,
            "expansion": 10.8e-6, "youngs_modulus": 120e9, "poisson_ratio": 0.25,
        },
    },
    "convection": {"side": 20.0},
    "heat": {"Q_motor_W": {"on": "left"}},
    "points": {f"T_{k}_degC": {"at": k / 10} for k in range(1, 10)},
    "deflections": {"d_tip_um": {"at": 1.0, "direction": "x"}},
    "supports": {"fixed": ["left"]},
}  # fmt: skip
BLOCK = {
    **ROD,
    "mesh": {"block": {"size": [0.2, 0.1, 0.08], "divisions": [10, 5, 4]}},
    "convection": {"left": 900.0},
    "heat": {"Q_motor_W": {"on": "right"}, "Q_all_W": {"on": "body"}},
    "points": {"T_tip_degC": {"at": [0.2, 0.05, 0.04]}},
    "deflections": {"d_tip_um": {"at": [0.2, 0.0, 0.08], "direction": "x"}},
}


@pytest.fixture
def rod():
    """A declaration that a test may change."""
    return copy.deepcopy(ROD)


@pytest.fixture
def block():
    """A declaration that a test may change."""
    return copy.deepcopy(BLOCK)


@pytest.fixture
def load():
    """The body of a declaration."""
    return lambda document: load_body(document, "body.toml", lambda path, unit: pytest.fail(path))
