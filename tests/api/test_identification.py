"""Transfer functions by the Python API, and a structure that somebody adds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.signal import lfilter

import thermaltool as tt
from thermaltool.api.result import silent
from thermaltool.errors import LogError
from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.transfer import registry
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.oe import OeStructure
from thermaltool.fitting.transfer.orders import Orders

POLE = np.exp(-10.0 / 300.0)


def record(seed: int = 1, rows: int = 900, period: float = 10.0) -> tt.Record:
    """Two readings that follow one heat with 300 s, white noise on both."""
    rng = np.random.default_rng(seed)
    heat = np.repeat(rng.uniform(0, 100, rows // 60), 60)
    heat[:30] = 0.0
    y = lfilter([0, 0.2 * (1 - POLE)], [1, -POLE], heat)
    noise = 0.02 * rng.standard_normal((2, rows))
    columns = {"Q_motor_W": heat, "d_z_um": y + noise[0], "d_x_um": 0.5 * y + noise[1]}
    return tt.Record(period * np.arange(rows), columns)


def call(data: Any, **options: Any) -> Any:
    return tt.identify(data, ["Q_motor_W"], ["d_z_um"], **{"orders": [(1, 1, 1)], **options})


@pytest.mark.parametrize("structure", registry.STRUCTURES)
def test_every_structure_gives_a_frame_a_table_and_a_model(structure: str) -> None:
    found = call(record(), structure=structure)
    low, high = found.frame.loc[("d_z_um", "b1"), ["low", "high"]]
    assert low < 0.2 * (1 - POLE) < high
    assert found.model.terms[0].response.dc_gain() == pytest.approx(0.2, rel=0.02)
    assert str(found).startswith(f"d_z_um: {structure.upper()} by")
    assert found.document()["models"][0]["structure"] == structure
    assert len(found.plot().axes) >= 1
    (fit,) = found.fits
    assert fit.parameters["b1"].low == low
    assert len(fit.covariance) == 2
    assert fit.criteria.aic < fit.criteria.bic
    assert fit.tests.independent_p["Q_motor_W"] > 1e-3


def test_a_network_shares_its_time_constants() -> None:
    outputs = ["d_z_um", "d_x_um"]
    found = tt.identify(record(), ["Q_motor_W"], outputs, structure="network", modes=1)
    values = found.frame["value"].xs("tau1", level="parameter")
    assert values["d_z_um"] == values["d_x_um"] == pytest.approx(300, rel=0.02)
    assert [term.response.dc_gain() for term in found.model.terms] == pytest.approx(
        [0.2, 0.1], rel=0.02
    )


@pytest.mark.slow
def test_a_subspace_model_finds_how_many_poles_its_outputs_share() -> None:
    found = tt.identify(record(), ["Q_motor_W"], ["d_z_um", "d_x_um"], structure="subspace",
                        validate=record(2))  # fmt: skip
    assert all(fit.model.order == 1 for fit in found.fits)
    assert found.frame["value"].xs("tau1", level="parameter")["d_x_um"] == pytest.approx(300, 0.02)
    gains = [term.response.dc_gain() for term in found.model.terms]
    assert gains == pytest.approx([0.2, 0.1], rel=0.02)
    first = found.document()["models"][0]
    assert first["structure"] == "subspace"
    assert first["orders"] == {"modes": 1, "feedthrough": False}
    assert first["validation"]["fit_percent"] > 95
    assert first["candidates"][0]["modes"] == 1
    assert first["units"] == {"tau1": "s", "K1": "um/W"}
    assert "1 shared mode by subspace identification" in found.table()


def test_validation_on_another_record_and_a_clock_that_differs() -> None:
    found = call(record(), validate=record(2))
    assert found.document()["models"][0]["validation"]["fit_percent"] > 95
    with pytest.raises(LogError, match="sampled every 20 s, the first log every 10 s"):
        call([record(), record(period=20.0)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"structure": "network"}, "a network takes --modes and --delay"),
        ({"structure": "arx", "initial": "rest"}, "arx takes its first rows as they are"),
        ({"noise_orders": (1, 1)}, "go with --structure armax and bj"),
        ({"continuous": True, "structure": "bj"}, "--continuous goes with --structure oe"),
        ({"modes": 2}, "--modes goes with --structure network, subspace, lpv and bilinear"),
        (
            {"delay": 5.0, "structure": "subspace", "orders": ()},
            "--delay goes with --structure network",
        ),
        ({"modes": 7, "structure": "network", "orders": ()}, "a network has up to 6"),
        ({"modes": 13, "structure": "subspace", "orders": ()}, "a subspace model has up to 12"),
        ({"structure": "subspace", "real_poles": True, "orders": ()}, "of a subspace any"),
        ({"split": 0.5, "validate": "other.csv"}, "both name the validation data"),
    ],
)
def test_arguments_that_contradict_each_other_are_refused(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call(record(), **options)


@dataclass(frozen=True)
class Doubled(OeStructure):
    """The input taken twice as strong: only there to be seen."""

    name: ClassVar[str] = "doubled"
    letter: ClassVar[str] = "g"

    def estimate(self, data: TrainingData, orders: Orders) -> TransferModel:
        twice = {name: 2 * data.records[0].column(name) for name in data.inputs}
        records = (data.records[0].with_columns(twice),)
        return super().estimate(TrainingData(records, data.inputs, data.outputs, data.period),
                                orders)  # fmt: skip


def test_a_structure_is_a_class_and_a_line_of_the_registry(monkeypatch: Any) -> None:
    class Entry(registry.StructureEntry):
        def load(self) -> type[Doubled]:
            return Doubled

    monkeypatch.setitem(registry.STRUCTURES, "doubled", Entry("", "", "nowhere"))
    assert registry.described().endswith(", or nowhere (doubled)")
    found = call(record(), structure="doubled")
    assert found.frame["value"]["d_z_um"].index.tolist() == ["g1", "b1"]
    assert found.frame["value"][("d_z_um", "b1")] == pytest.approx(0.1 * (1 - POLE), rel=0.05)
    assert "DOUBLED" in str(found)


@pytest.mark.parametrize(
    "options",
    [
        {"orders": [(1, 1, 1)]},
        {"structure": "arx", "orders": [(1, 1, 1)]},
        {"structure": "network", "modes": 1},
        {"structure": "subspace", "modes": 1},
    ],
)
def test_printed_validation_is_simulate_carried_on(options: dict[str, Any]) -> None:
    log = "data_samples/frame_step100_first10min.csv"
    found = tt.identify(log, "Q_main_1", "dT_pair1_K", split=0.6, warn=silent, **options)
    (fit,) = found.fits
    assert fit.validation is not None
    (held,) = fit.validation.logs
    run = tt.simulate(
        found.model, log, initial=held.initial, start=held.start, stop=held.stop, warn=silent
    )
    assert run.agreements["dT_pair1_K"].fit_percent == pytest.approx(held.fit_percent, abs=0.5)
