"""The Python API: loaded lazily, documented with examples that run, results that print and draw."""

from __future__ import annotations

import doctest
import importlib
import inspect
import subprocess
import sys
from types import ModuleType

import pytest

import thermaltool as tt
from thermaltool import api

FUNCTIONS = [name for name in api.__all__ if inspect.isfunction(getattr(tt, name))]
RESULTS = [name for name in api.__all__ if inspect.isclass(getattr(tt, name))]


def test_the_import_is_quick_and_loads_no_numpy() -> None:
    code = """
import importlib, sys, time, typing
start = time.perf_counter()
import thermaltool
print(time.perf_counter() - start)
dir(thermaltool)
assert "numpy" not in sys.modules
"""
    starts = [
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
        for _ in range(5)
    ]
    assert min(float(each.stdout) for each in starts) < 0.02


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibarte'"):
        _ = tt.calibarte
    assert set(api.__all__) <= set(dir(tt))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented_with_an_example(name: str) -> None:
    text = inspect.getdoc(getattr(tt, name)) or ""
    arguments = list(inspect.signature(getattr(tt, name)).parameters)
    for section in ("Parameters\n---", "Examples\n---"):
        assert section in text, section
    for argument in arguments:
        assert argument in text.partition("Parameters")[2], argument


def modules() -> list[ModuleType]:
    names = sorted(set(api._MODULES.values()))
    return [importlib.import_module(f"thermaltool.api.{name}") for name in names]


@pytest.mark.parametrize("module", modules(), ids=lambda module: module.__name__.rpartition(".")[2])
def test_examples_run(module: ModuleType) -> None:
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for test in finder.find(module):
        runner.run(test)
    assert runner.summarize().failed == 0


@pytest.mark.parametrize("name", RESULTS)
def test_results_say_what_they_hold(name: str) -> None:
    assert inspect.getdoc(getattr(tt, name))
    assert callable(getattr(tt, name).table)


def test_a_check_prints_and_draws() -> None:
    result = tt.check("data_samples/frame_step100_first10min.csv")
    assert result.passed
    assert str(result).splitlines()[-1] == "nothing wrong"
    assert repr(result) == str(result) == result.table()
    assert len(result.plot().axes) == 4


def test_noise_as_a_frame_and_as_the_next_stage_reads_it() -> None:
    from thermaltool.api.inputs import read_noise

    result = tt.noise("data_samples/frame_idle.parquet", channels=["dT_pair1_K"])
    white = result.frame.loc["dT_pair1_K", "white_sigma"]
    assert 0.015 < white < 0.025
    assert read_noise(result)["dT_pair1_K"].white == white
    assert len(result.plot().axes) == 3


def test_an_inversion_is_a_frame_and_knows_where_it_failed() -> None:
    result = tt.invert_laplace("exp(-s)/s", [0.5, 1.0001, 2.0])
    assert result.missed == 1
    assert "at t = 1.0001 s exceeds 1e-09 (1 of 3 times)" in result.warning()
    assert result.frame.index.tolist() == [0.5, 1.0001, 2.0]
    assert tt.invert_laplace(lambda s: 1 / s, [1.0]).warning() == ""
    with pytest.raises(ValueError, match="parameters belong to an expression"):
        tt.invert_laplace(lambda s: 1 / s, [1.0], parameters={"a": 1.0})
