"""Coefficients, likelihoods, criteria and forecasts that others have published or computed.

R: arima, ar and predict of R 4.2.2, in tests/reference/published/series/R_reference_fits.txt.
"BD": P. J. Brockwell, R. A. Davis, Introduction to Time Series and Forecasting (2002).
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from reference.measured import published
from scipy.signal import lfilter

from thermaltool.record import Record
from thermaltool.timeseries.ar import ArOrders, burg, least_squares, yule_walker
from thermaltool.timeseries.criteria import OrderCriteria
from thermaltool.timeseries.fit import fit_arma
from thermaltool.timeseries.forecast import forecast
from thermaltool.timeseries.hannan import hannan_rissanen
from thermaltool.timeseries.innovations import innovations
from thermaltool.timeseries.likelihood import ArmaLikelihood
from thermaltool.timeseries.model import ArmaModel
from thermaltool.timeseries.runs import even_record

# P. J. Diggle, Time Series: A Biostatistical Introduction (1990), table A.1: luteinizing hormone.
LH = np.fromstring(
    """
    2.4 2.4 2.4 2.2 2.1 1.5 2.3 2.3 2.5 2.0 1.9 1.7 2.2 1.8 3.2 3.2
    2.7 2.2 2.2 1.9 1.9 1.8 2.7 3.0 2.3 2.0 2.0 2.9 2.9 2.7 2.7 2.3
    2.6 2.4 1.8 1.7 1.5 1.4 2.1 3.3 3.5 3.5 3.1 2.6 2.1 3.4 3.0 2.9
    """,
    sep=" ",
)


def series(name: str) -> np.ndarray:
    table = np.genfromtxt(published(f"series/{name}"), delimiter=",", skip_header=1)
    return table if table.ndim == 1 else table[:, -1]


def block(title: str) -> str:
    """What R printed under a title."""
    text = published("series/R_reference_fits.txt").read_text()
    return text.split(f"### {title}", 1)[1].split("\n### ", 1)[0]


def numbers(text: str) -> list[float]:
    text = re.sub(r"\[\s*\d+(,\s*\d*)?\]|\[,\d+\]", " ", text)
    return [float(word) for word in re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", text)]


DATA = {
    "lh": lambda: LH,
    "LakeHuron": lambda: series("LakeHuron.csv"),
    "lynx": lambda: np.log10(series("lynx.csv")),
    "sunspot": lambda: series("sunspot.year.csv"),
    "A": lambda: series("BoxJenkins_SeriesA.csv"),
    "C": lambda: series("BoxJenkins_seriesC.csv"),
    "robot": lambda: series("TSA_robot.csv"),
}

# title, series, p, q, difference, degree
FITS = [
    ("arima(lh,c(1,0,0))", "lh", 1, 0, 0, 0),
    ("arima(lh,c(3,0,0))", "lh", 3, 0, 0, 0),
    ("arima(LakeHuron,c(2,0,0),xreg=time-1920)", "LakeHuron", 2, 0, 0, 1),
    ("arima(LakeHuron,c(1,0,1))", "LakeHuron", 1, 1, 0, 0),
    ("arima(LakeHuron,c(2,0,0))", "LakeHuron", 2, 0, 0, 0),
    ("arima(log10(lynx),c(2,0,0))", "lynx", 2, 0, 0, 0),
    ("arima(log10(lynx),c(11,0,0))", "lynx", 11, 0, 0, 0),
    ("arima(sqrt sunspot.year? no: sunspot.year c(9,0,0))", "sunspot", 9, 0, 0, 0),
    ("arima(window(sunspot.year,1770,1869),c(2,0,0))", "sunspots 1770", 2, 0, 0, 0),
    ("Box-Jenkins Series A, ARMA(1,1)", "A", 1, 1, 0, 0),
    ("Series A, ARIMA(0,1,1)", "A", 0, 1, 1, -1),
    ("Series A, AR(7)", "A", 7, 0, 0, 0),
    ("Box-Jenkins Series C, ARIMA(1,1,0)", "C", 1, 0, 1, -1),
    ("Series C, ARIMA(0,2,2)", "C", 0, 2, 2, -1),
    ("TSA robot ARMA(1,1)", "robot", 1, 1, 0, 0),
    ("TSA robot IMA(1,1)", "robot", 0, 1, 1, -1),
]


@pytest.mark.parametrize(("title", "name", "p", "q", "d", "degree"), FITS)
def test_exact_maximum_likelihood_agrees_with_r(
    title: str, name: str, p: int, q: int, d: int, degree: int
) -> None:
    x = series("sunspot.year.csv")[70:170] if name == "sunspots 1770" else DATA[name]()
    model = fit_arma(even_record(x), p, q, degree=degree, difference=d)
    text = block(title)
    sigma2, loglik, aic, bic = (
        float(re.search(rf"{key} (\S+)", text).group(1))  # type: ignore[union-attr]
        for key in ("\nsigma2", "loglik", "aic", "bic")
    )
    # R stops where the likelihood is flat to 1e-8: never above the maximum. Its differences start
    # from a diffuse level of finite variance, which changes the fifth digit.
    assert -0.5 * model.entry.deviance >= loglik - (1e-5 if d == 0 else 5e-4)
    assert -0.5 * model.entry.deviance == pytest.approx(loglik, abs=5e-4)
    assert model.entry.criteria.aic == pytest.approx(aic, abs=1e-3)
    assert model.entry.criteria.bic == pytest.approx(bic, abs=1e-3)
    assert model.sigma2 == pytest.approx(sigma2, rel=2e-4)
    published = numbers(text.split("\n", 1)[1].split("sigma2")[0])
    for value, r in zip([*model.ar, *model.ma], published, strict=False):
        assert value == pytest.approx(r, abs=2.5e-4)
    errors = published[p + q + degree + 1 :]
    for value, r in zip(model.errors, errors, strict=False):
        assert value == pytest.approx(r, rel=0.01)


def test_likelihood_at_the_coefficients_of_r_agrees_in_nine_digits() -> None:
    likelihood = ArmaLikelihood(even_record(DATA["LakeHuron"]()), 0)
    at = likelihood.at(np.array([0.7448993197]), np.array([0.3205890685]))
    assert -0.5 * at.deviance == pytest.approx(-103.2452606, abs=1e-7)
    assert at.sigma2 == pytest.approx(0.4749398386, abs=2e-9)
    assert at.coefficients[0] + likelihood.offset == pytest.approx(579.0554555560, abs=1e-5)


def centred(x: np.ndarray) -> Record:
    return even_record(x - x.mean())


@pytest.mark.parametrize(
    ("title", "name", "method", "order"),
    [
        ("ar.yw(lynx log10)", "lynx", yule_walker, 20),
        ("ar.burg(log10 lynx)", "lynx", burg, 20),
        ("ar.yw(lh)", "lh", yule_walker, 16),
        ("ar.burg(lh)", "lh", burg, 16),
        ("ar.ols(lh)", "lh", least_squares, 16),
        ("ar.yw(sunspot.year)", "sunspot", yule_walker, 24),
        ("ar.burg(sunspot.year)", "sunspot", burg, 24),
        ("ar.burg(LakeHuron)", "LakeHuron", burg, 19),
    ],
)
def test_ar_tables_agree_with_r_in_eight_digits(title: str, name: str, method, order: int) -> None:
    x = DATA[name]()
    orders: ArOrders = method(centred(x), order)
    text = block(title)
    best = int(re.search(r"order (\d+)", text).group(1))  # type: ignore[union-attr]
    assert orders.best == best
    coefficients = numbers(text.split("\n", 1)[1].split("AIC diffs")[0])
    np.testing.assert_allclose(orders.coefficients[best], coefficients, atol=2e-9)
    lines = text.split("AIC diffs:\n")[1].splitlines()
    differences = numbers(" ".join(line for line in lines if "." in line))
    aic = np.array([each.aic for each in orders.criteria])
    np.testing.assert_allclose(aic - aic.min(), differences, atol=2e-8)
    variance = float(re.search(r"var.pred (\S+)", text).group(1))  # type: ignore[union-attr]
    corrected = orders.variance[best] * (
        x.size / (x.size - best - 1) if method is yule_walker else 1.0
    )
    assert corrected == pytest.approx(variance, rel=1e-8)


@pytest.mark.parametrize(
    ("title", "name", "order", "steps"),
    [("predict(arima(lh,c(3,0,0))", "lh", 3, 12), ("predict(arima(LakeHuron", "LakeHuron", 2, 10)],
)
def test_forecasts_agree_with_r(title: str, name: str, order: int, steps: int) -> None:
    x = DATA[name]()
    text = block(f"arima({name},c({order},0,0))")
    *ar, mean, sigma2 = numbers(text)[: order + 2]
    entry = OrderCriteria(order, 0, 0.0, sigma2, x.size, 1, True)
    model = ArmaModel("x", 1.0, 0, np.array(ar), np.empty(0), (mean,), np.zeros((1, 1)),
                      sigma2, None, entry, "ml")  # fmt: skip
    ahead = forecast(model, even_record(x), steps)
    predicted, errors = block(title).split("$se")
    np.testing.assert_allclose(ahead.value, numbers(predicted)[-steps:], atol=2e-7)
    np.testing.assert_allclose(ahead.error, numbers(errors)[:steps], atol=2e-9)
    # The model fitted here differs from that of R by where the two searches stop.
    own = forecast(fit_arma(even_record(x), order, 0), even_record(x), steps)
    np.testing.assert_allclose(own.value, numbers(predicted)[-steps:], atol=3e-4)


def test_hannan_rissanen_of_the_lake() -> None:
    # BD example 5.1.7: two regressions after an AR(22); itsmr prints 0.69607715, 0.3787969217 and
    # the variance 0.4773580109.
    x = centred(series("BD2002_lake.csv"))
    fit = hannan_rissanen(x, 1, 1, 22, correct=False)
    assert fit.ar[0] == pytest.approx(0.69607715, abs=1e-8)
    assert fit.ma[0] == pytest.approx(0.3787969217, abs=1e-9)
    at = ArmaLikelihood(x, -1).at(fit.ar, fit.ma)
    assert at.sigma2 == pytest.approx(0.4773580109, abs=1e-9)
    # The third regression leads to the maximum of the likelihood, 0.7449, 0.3206.
    corrected = hannan_rissanen(x, 1, 1, 22)
    assert corrected.corrected
    assert abs(corrected.ar[0] - 0.7449) < 0.2 * abs(fit.ar[0] - 0.7449)


def test_innovations_estimates_of_the_lake() -> None:
    ar, ma = innovations(centred(series("BD2002_lake.csv")), 1, 1, 17)
    assert (ar[0], ma[0]) == (pytest.approx(0.7234, abs=5e-5), pytest.approx(0.3596, abs=5e-5))


def mean_square_both_ways(x: np.ndarray, ar: np.ndarray) -> float:
    """Of the forward and backward errors, the estimate of the variance that the book prints."""
    weights = np.concatenate(([1.0], -ar))
    errors = [lfilter(weights, [1.0], each)[ar.size :] for each in (x, x[::-1])]
    return float(np.mean(np.square(errors)))


def test_burg_of_brockwell_and_davis() -> None:
    for x, ar, variance in (
        (series("BD2002_lake.csv"), [1.0449, -0.2456], 0.4706),
        (np.diff(series("BD2002_dowj.csv")), [0.4371], 0.1423),
    ):
        found = burg(centred(x), len(ar)).coefficients[-1]
        np.testing.assert_allclose(found, ar, atol=5e-5)
        assert mean_square_both_ways(x - x.mean(), found) == pytest.approx(variance, abs=5e-5)


def test_maximum_likelihood_of_brockwell_and_davis_and_box_and_jenkins() -> None:
    lake = fit_arma(even_record(series("BD2002_lake.csv")), 1, 1)
    assert lake.ar[0] == pytest.approx(0.7446, abs=5e-4)
    assert lake.ma[0] == pytest.approx(0.3213, abs=1e-3)
    assert lake.sigma2 == pytest.approx(0.4750, abs=1e-4)
    # Box and Jenkins (1976) p. 239 print theta = -ma, to two digits.
    A = fit_arma(even_record(DATA["A"]()), 1, 1)
    assert A.ar[0] == pytest.approx(0.92, abs=0.02)
    assert -A.ma[0] == pytest.approx(0.58, abs=0.01)
    assert A.sigma2 == pytest.approx(0.097, abs=1e-3)
