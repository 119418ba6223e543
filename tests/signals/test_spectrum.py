import numpy as np
import pytest

from thermaltool.signals.spectrum import find_lines, thin, welch_spectrum


def test_white_density_integrates_to_the_variance():
    y = 0.3 * np.random.default_rng(1).standard_normal(40000)
    spectrum = welch_spectrum([y[:25000], y[25000:]], 0.1)
    assert spectrum.density.mean() == pytest.approx(2.0 * 0.1 * 0.09, rel=0.02)
    # Scatter of the bins is what the degrees of freedom say.
    relative = spectrum.density / spectrum.density.mean()
    assert relative.var() == pytest.approx(2.0 / spectrum.dof, rel=0.15)


def test_line_is_found_with_its_amplitude():
    t = 0.5 * np.arange(8000)
    y = np.random.default_rng(2).standard_normal(8000) + 0.4 * np.sin(2 * np.pi * 0.31 * t)
    spectrum = welch_spectrum([y], 0.5)
    (line,) = find_lines(spectrum, np.ones_like(spectrum.frequency))
    assert line.frequency == pytest.approx(0.31, abs=2 * 2.0 / 1024)
    assert line.amplitude == pytest.approx(0.4, rel=0.15)
    assert line.p_value < 1e-6


def test_false_alarms_are_as_rare_as_stated():
    found = 0
    for k in range(300):
        spectrum = welch_spectrum([np.random.default_rng([3, k]).standard_normal(3000)], 1.0)
        found += bool(find_lines(spectrum, np.ones_like(spectrum.frequency)))
    assert found <= 12  # 3 expected at one in a hundred; the estimated floor costs a little


def test_short_runs_have_no_spectrum():
    assert welch_spectrum([np.zeros(3)] * 100, 4.0) is None
    assert welch_spectrum([], 1.0) is None


def test_thin_keeps_the_power():
    spectrum = welch_spectrum([np.random.default_rng(4).standard_normal(30000)], 1.0)
    frequency, density = thin(spectrum)
    assert frequency.size <= 201
    assert (np.diff(frequency) > 0).all()
    assert density.mean() == pytest.approx(2.0, rel=0.1)
