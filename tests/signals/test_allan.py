"""Allan deviation against published test data and noise of known kind."""

import numpy as np
import pytest

from thermaltool.signals.allan import (
    FLICKER,
    RANDOM_WALK,
    WHITE,
    allan_deviation,
    equivalent_dof,
    noise_kind,
)

# NBS Monograph 140 (1974), Annex 8.E, the 9 frequencies; deviations in NIST SP 1065, Table 30.
NBS14 = [892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0]


def sp1065_data() -> np.ndarray:
    """The 1000 frequencies of NIST SP 1065, §12.4: a prescribed random number generator."""
    n = [1234567890]
    for _ in range(999):
        n.append(16807 * n[-1] % 2147483647)
    assert n[1:4] == [395529916, 1209410747, 633705974]  # given in the text
    return np.array(n) / 2147483647


def test_nbs14():
    result = allan_deviation(NBS14, 1.0, [1, 2])
    np.testing.assert_allclose(result.deviation, [91.22945, 85.95287], rtol=1e-6)


def test_sp1065_deviation():
    result = allan_deviation(sp1065_data(), 1.0, [1, 10, 100])
    np.testing.assert_allclose(
        result.deviation, [2.922319e-01, 9.159953e-02, 3.241343e-02], rtol=1e-6
    )


def test_sp1065_confidence():
    # SP 1065, Table 32: white FM, m = 10, edf 146.177, 95 % limits. Its edf rests on a truncated
    # sum and its chi-square on an approximation, both good to about a thousandth.
    result = allan_deviation(sp1065_data(), 1.0, [10])
    assert result.kind[0] == WHITE
    assert result.edf[0] == pytest.approx(146.177, rel=1e-3)
    assert result.low[0] == pytest.approx(8.223942e-02, rel=2e-3)
    assert result.high[0] == pytest.approx(1.035201e-01, rel=2e-3)


def test_shift_and_scale():
    y = sp1065_data()
    a, b = allan_deviation(y, 1.0), allan_deviation(1e5 + 3.0 * y, 2.0)
    np.testing.assert_allclose(b.deviation, 3.0 * a.deviation, rtol=1e-6)
    np.testing.assert_allclose(b.tau, 2.0 * a.tau)


@pytest.mark.parametrize(
    ("make", "kind", "slope"),
    [(lambda w: w, WHITE, -0.5), (np.cumsum, RANDOM_WALK, 0.5)],
    ids=["white", "walk"],
)
def test_known_noise(make, kind, slope):
    y = make(np.random.default_rng(1).standard_normal(20000))
    result = allan_deviation(y, 1.0, [2, 4, 8, 16, 32, 64])
    assert (result.kind == kind).all()
    fitted = np.polyfit(np.log(result.tau), np.log(result.deviation), 1)[0]
    assert fitted == pytest.approx(slope, abs=0.05)


def test_flicker_noise():
    rng = np.random.default_rng(2)
    spectrum = np.fft.rfft(rng.standard_normal(2**15))
    spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
    y = np.fft.irfft(spectrum)
    assert noise_kind(y, 8) == FLICKER


@pytest.mark.parametrize(("kind", "walk"), [(WHITE, False), (RANDOM_WALK, True)])
def test_edf_is_the_spread_of_the_variance(kind, walk):
    # edf = 2 mean² / variance over many records.
    n, m, records = 200, 10, 2000
    y = np.random.default_rng(3).standard_normal((records, n))
    y = np.cumsum(y, axis=1) if walk else y
    avar = np.array([allan_deviation(row, 1.0, [m]).deviation[0] ** 2 for row in y])
    edf = 2.0 * avar.mean() ** 2 / avar.var()
    assert equivalent_dof(n + 1, m, kind) == pytest.approx(edf, rel=0.15)


def test_bad_input():
    with pytest.raises(ValueError, match="at least 3"):
        allan_deviation([1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="finite"):
        allan_deviation([1.0, np.nan, 2.0, 3.0], 1.0)
    with pytest.raises(ValueError, match="factors"):
        allan_deviation(np.arange(10.0), 1.0, [6])
