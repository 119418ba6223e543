"""A mesh updated from logs of a rod by finite volumes, whose film and heat are others."""

from dataclasses import replace

import numpy as np
import pytest
from machines.expanding_rod import OUTPUT, ROD, random_heat, rod_columns

import thermaltool as tt
from thermaltool.errors import FitError, LogError
from thermaltool.model import agreements
from thermaltool.record import Record

FILM, SHARE, NOISE = 33.0, 0.8, 0.05


def log_of(seed, rows, held):
    rng = np.random.default_rng(seed)
    heat = random_heat(rng, rows, held)
    columns = rod_columns(SHARE * heat, 10.0, rng, NOISE, replace(ROD, film=FILM))
    columns[OUTPUT] = columns[OUTPUT] + 0.3 * rng.standard_normal(rows)
    time = columns.pop("time_s")
    return Record(time, {**columns, "Q_motor_W": heat}, digest=f"{seed}")


@pytest.fixture
def mesh(rod):
    rod["mesh"]["rod"]["elements"] = 80
    rod["points"] = {name: rod["points"][name] for name in ("T_1_degC", "T_5_degC")}
    return rod


@pytest.mark.slow
def test_an_hour_tells_film_and_heat_and_the_updated_mesh_holds_on_another_duty(mesh):
    """The declared film is 20; the mesh alone and the logs alone are both worse."""
    hour, unseen = log_of(1, 360, 60), log_of(2, 2880, 180)
    found = tt.calibrate_body(mesh, hour)
    own = {(p.kind, p.name): p for p in found.parameters}
    assert own["film", "side"].estimate.value == pytest.approx(FILM, rel=0.02)
    assert own["heat", "Q_motor_W"].estimate.value == pytest.approx(SHARE, rel=0.01)
    assert all(each.identified for each in found.parameters)
    logs_alone = tt.calibrate(
        hour, "Q_motor_W", sensors=tuple(mesh["points"]), deflections=OUTPUT
    ).model
    others = [tt.thermal_modes(mesh).model, logs_alone]
    updated, *rest = (agreements(m, [unseen], initial="rest") for m in (found.model, *others))
    noise = dict.fromkeys(mesh["points"], NOISE) | {OUTPUT: 0.3}
    assert all(updated[name].rmse_zero_free < 1.5 * sigma for name, sigma in noise.items())
    for each in rest:
        parts = [each[name].rmse_zero_free / updated[name].rmse_zero_free for name in noise]
        assert np.exp(np.mean(np.log(parts))) > 2


def test_what_logs_do_not_show_stays_near_what_is_declared(mesh):
    """A few minutes at the heated end say nothing of the film."""
    log = log_of(3, 30, 30)
    short = Record(log.time, {n: log.column(n) for n in ("Q_motor_W", "T_1_degC")})
    found = tt.calibrate_body(mesh, short)
    film = next(p for p in found.parameters if p.kind == "film")
    assert not film.identified
    assert 10 < film.estimate.value < 40
    assert any("film coefficient of side" in note for note in found.notes)
    # What the log does not have is the mesh's, and says so.
    assert "no log has it" in found.table()


def test_readings_that_are_missing_are_left_out(mesh):
    log = log_of(1, 360, 60)
    holed = log.column("T_5_degC").copy()
    holed[50:300:7] = np.nan
    columns = {name: log.column(name) for name in log.columns} | {"T_5_degC": holed}
    whole, found = (
        tt.calibrate_body(mesh, each, nan_policy="omit")
        for each in (log, Record(log.time, columns))
    )
    for one, other in zip(whole.parameters, found.parameters, strict=True):
        assert other.factor == pytest.approx(one.factor, rel=0.01)


def test_logs_without_the_heat_or_any_output_are_refused(mesh):
    log = log_of(1, 60, 60)
    bare = Record(log.time, {"Q_motor_W": log.column("Q_motor_W")})
    still = Record(log.time, {"Q_motor_W": log.column("Q_motor_W"), "T_1_degC": 0 * log.time})
    with pytest.raises(FitError, match="T_1_degC is constant"):
        tt.calibrate_body(mesh, still)
    with pytest.raises(FitError, match="no log has readings of a point or a deflection"):
        tt.calibrate_body(mesh, bare)
    with pytest.raises(LogError, match="no column Q_motor_W"):
        tt.calibrate_body(mesh, Record(log.time, {"T_1_degC": log.column("T_1_degC")}))
