"""Numerical inversion of Laplace transforms.

`thermaltool.laplace.expression` turns a user's expression of s into a transfer function; it alone
needs SciPy and is imported by itself.
"""

from thermaltool.laplace.inversion import METHODS, Inversion, invert

__all__ = ["METHODS", "Inversion", "invert"]
