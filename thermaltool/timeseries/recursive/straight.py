"""Loops over a few coefficients written out as straight-line functions of plain floats.

Interpreted loops over lists cost about three times what their arithmetic does. So the inner loops
of the recursions are written out once for their size, as source text, and compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

Floats = Sequence[float]
# theta, D, U and the error a posteriori, from phi, error, forgetting, bound of D, theta, D, U.
Update = Callable[
    [Floats, float, float, float, Floats, Floats, Floats],
    tuple[list[float], list[float], list[float], float],
]
# Means and error variances, from x, a, theta, the constant regressor, sigma2 and the steps.
Forecasts = Callable[[Floats, Floats, Floats, float, float, int], tuple[list[float], list[float]]]


def _compiled(name: str, arguments: str, lines: list[str]) -> Any:
    text = "\n    ".join([f"def {name}({arguments}):", *lines])
    space: dict[str, Any] = {}
    exec(compile(text, f"<{name}>", "exec"), space)
    return space[name]


def _names(letter: str, count: int) -> str:
    return "".join(f"{letter}{k}," for k in range(count))


@cache
def update_function(n: int) -> Update:
    """The measurement update of `least_squares.RecursiveLeastSquares` for n parameters.

    U is flat: column j above its diagonal (entries 0 to j − 1), one column after the other.
    """
    upper = [f"u{i}_{j}" for j in range(n) for i in range(j)]
    columns = "".join(f"{name}," for name in upper)
    lines = [f"{_names('p', n)} = phi", f"{_names('d', n)} = D", f"{_names('t', n)} = theta"]
    if upper:
        lines.append(f"{columns} = U")
    lines.append("a = forgetting")
    for j in range(n):
        dot = "".join(f" + u{i}_{j}*p{i}" for i in range(j))
        lines += [f"f = p{j}{dot}", f"g = d{j}*f", "b = a", "a = b + f*g"]
        lines += [f"d{j} = d{j}*b/(a*forgetting)", f"if d{j} > bound: d{j} = bound"]
        if j:
            lines.append("m = -f/b")
        for i in range(j):
            lines += [f"u = u{i}_{j}", f"u{i}_{j} = u + m*k{i}", f"k{i} += g*u"]
        lines.append(f"k{j} = g")
    lines.append("s = error/a")
    theta = ", ".join(f"t{k} + s*k{k}" for k in range(n))
    lines.append(f"return [{theta}], [{_names('d', n)}], [{columns}], s*forgetting")
    function: Update = _compiled("update", "phi, error, forgetting, bound, theta, D, U", lines)
    return function


@cache
def forecast_function(p: int, q: int) -> Forecasts:
    """Conditional expectation of ARMA(p, q) and the variance of its error, step by step.

    x̂(l) = c + Σ φ_i x̂(l − i) + Σ_{j ≥ l} θ_j a(l − j) and Var(l) = σ² Σ_{k < l} ψ_k² with
    ψ_k = θ_k + Σ φ_i ψ_{k−i}, ψ_0 = 1 (Gao 2000, eq. 4-22 and 4-37, signs of θ as here).
    """
    w = [f"w{k}" for k in range(p)]
    past = "".join(f" + f{i}*x{i}" for i in range(p))
    green = " + ".join(f"f{i}*w{i}" for i in range(p)) or "0.0"
    shift = [f"x{k} = x{k - 1}" for k in range(p - 1, 0, -1)] + (["x0 = y"] if p else [])
    shift_green = [f"w{k} = w{k - 1}" for k in range(p - 1, 0, -1)] + (["w0 = g"] if p else [])
    lines = [f"{_names('f', p)}{_names('h', q)}c, = theta", "c *= one", "means = []", "parts = []"]
    lines += [f"{_names('x', p)} = x"] if p else []
    lines += [f"{_names('a', q)} = a"] if q else []
    lines += [f"{name} = 0.0" for name in w] + ["g = 1.0", *(["w0 = g"] if p else []), "v = 0.0"]
    for step in range(q):
        late = "".join(f" + h{j}*a{j - step}" for j in range(step, q))
        lines += [f"y = c{past}{late}", *shift, "v += g*g", "means.append(y)", "parts.append(v)"]
        lines += [f"if steps == {step + 1}: return means, [sigma2*v for v in parts]"]
        lines += [f"g = h{step} + {green}", *shift_green]
    lines += [f"for _ in range(steps - {q}):"]
    body = [f"y = c{past}", *shift, "v += g*g", "means.append(y)", "parts.append(v)"]
    body += [f"g = {green}", *shift_green]
    lines += ["    " + line for line in body] + ["return means, [sigma2*v for v in parts]"]
    function: Forecasts = _compiled("forecast", "x, a, theta, one, sigma2, steps", lines)
    return function
