"""Numerical inversion of a Laplace transform."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thermaltool.api.result import Result, to_frame

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from thermaltool.laplace.inversion import Inversion
    from thermaltool.laplace.sampling import Transfer


@dataclass(frozen=True, repr=False)
class LaplaceInversion(Result):
    """A function of time, from its transform.

    Attributes
    ----------
    inversion : Inversion
        Times, values, errors estimated and wanted, method, abscissa and number of evaluations.
    """

    inversion: Inversion

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """``time_s``, ``value_1`` and ``error_1`` (NaN where there is no answer), shape (n,)."""
        import numpy as np

        found = self.inversion
        error = np.where(np.isfinite(found.error), found.error, np.nan)
        return {"time_s": found.t, "value_1": found.values, "error_1": error}

    @property
    def frame(self) -> pandas.DataFrame:
        """Values and their estimated errors against time [s]."""
        return to_frame(self.columns)

    @property
    def missed(self) -> int:
        """Number of times at which the estimated error exceeds the wanted one."""
        return int((self.inversion.error > self.inversion.wanted).sum())

    def document(self) -> dict[str, Any]:
        """The result as JSON-ready data, null where there is no answer."""
        from thermaltool.documents import jsonable

        found = self.inversion
        how = {
            "method": found.method,
            "evaluations": found.evaluations,
            "abscissa": found.abscissa,
            "wanted": found.wanted,
        }
        document: dict[str, Any] = jsonable(how | self.columns)
        return document

    def table(self) -> str:
        """How it was found, and how well."""
        found = self.inversion
        worst = f", largest estimated error {found.error.max():.2g}" if found.t.size else ""
        shift = f", singularities up to {found.abscissa:.4g}/s" if found.abscissa else ""
        return (
            f"{found.t.size} times by {found.method}, {found.evaluations} evaluations{shift}"
            f"{worst} ({self.missed} above the error wanted)"
        )

    def warning(self) -> str:
        """Where the error exceeds the wanted one most; empty where it does not."""
        if not self.missed:
            return ""
        found = self.inversion
        worst = int((found.error / found.wanted).argmax())
        return (
            f"estimated error {found.error[worst]:.2g} at t = {found.t[worst]:g} s exceeds "
            f"{found.wanted[worst]:.2g} ({self.missed} of {found.t.size} times)"
        )

    def draw(self) -> Figure:
        """The values, and their estimated errors below."""
        from thermaltool.report.kernels import draw_inversion

        return draw_inversion(self.columns | {"wanted": self.inversion.wanted}, "values")


def invert_laplace(
    transfer: str | Transfer,
    times: ArrayLike,
    *,
    parameters: Mapping[str, float] | None = None,
    method: str = "auto",
    tol: float = 1e-9,
    rtol: float = 1e-9,
    abscissa: float | None = None,
) -> LaplaceInversion:
    """Invert a Laplace transform F(s) numerically, with an error estimate.

    Parameters
    ----------
    transfer : str or callable
        F: an expression of s and of the names in `parameters`, or a function of a complex
        ndarray of shape (m,) [1/s] that returns the same shape.
    times : array_like, shape (n,) [s]
        Above 0, in any order.
    parameters : mapping of name to value, optional
    method : {"auto", "hyperbola", "talbot", "euler", "dehoog", "stehfest"}
    tol, rtol : float
        Error wanted: `tol`, in the unit of the result, or `rtol` of the largest result up to
        that time, whichever is larger.
    abscissa : float [1/s], optional
        Largest real part of the singularities of F, taken as known; found where not given.

    Returns
    -------
    LaplaceInversion

    Raises
    ------
    ExpressionError
        An expression that cannot be understood.
    ValueError, FitError
        See `thermaltool.laplace.invert`.

    Examples
    --------
    >>> import thermaltool as tt
    >>> result = tt.invert_laplace("1/(s + a)", [1.0, 2.0], parameters={"a": 1.0})
    >>> result.frame["value_1"].round(6).tolist()
    [0.367879, 0.135335]
    """
    from thermaltool.laplace import invert

    if isinstance(transfer, str):
        from thermaltool.laplace.expression import compile_expression

        transfer = compile_expression(transfer, dict(parameters or {}))
    elif parameters:
        raise ValueError("parameters belong to an expression, not to a function")
    return LaplaceInversion(
        invert(transfer, times, method=method, tol=tol, rtol=rtol, abscissa=abscissa)
    )
