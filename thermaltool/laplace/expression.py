"""A user's own expression of s as a function of a complex array, evaluated without `eval`."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
from scipy import special

from thermaltool.errors import ThermalToolError
from thermaltool.laplace.sampling import ComplexArray, Transfer

# Bounds on what is parsed: evaluation recurses to the depth of the syntax tree.
MAX_CHARACTERS, MAX_DEPTH = 4000, 300
CONSTANTS = {"pi": np.pi, "e": np.e}
RESERVED = ("s", *CONSTANTS)

# The value of a part of the expression: an array of s's shape, or a number.
Node = Callable[[ComplexArray], Any]


class ExpressionError(ThermalToolError, ValueError):
    """An expression that cannot be understood; the message shows where."""


def _ie(order: int, z: Any) -> Any:
    """e^(−z)·I_ν(z). SciPy scales by the modulus, which is not analytic; this is."""
    return special.ive(order, z) * np.exp(abs(z.real) - z)


# name -> (number of arguments, function); orders of Bessel functions are real.
FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "sqrt": (1, np.sqrt),
    "exp": (1, np.exp),
    "log": (1, np.log),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tan": (1, np.tan),
    "sinh": (1, np.sinh),
    "cosh": (1, np.cosh),
    "tanh": (1, np.tanh),
    "asinh": (1, np.arcsinh),
    "j0": (1, lambda z: special.jv(0, z)),
    "j1": (1, lambda z: special.jv(1, z)),
    "i0": (1, lambda z: special.iv(0, z)),
    "i1": (1, lambda z: special.iv(1, z)),
    "k0": (1, lambda z: special.kv(0, z)),
    "k1": (1, lambda z: special.kv(1, z)),
    "i0e": (1, lambda z: _ie(0, z)),
    "i1e": (1, lambda z: _ie(1, z)),
    "k0e": (1, lambda z: special.kve(0, z)),
    "k1e": (1, lambda z: special.kve(1, z)),
    "jv": (2, lambda v, z: special.jv(v.real, z)),
    "iv": (2, lambda v, z: special.iv(v.real, z)),
    "kv": (2, lambda v, z: special.kv(v.real, z)),
    "erf": (1, special.erf),
    "erfc": (1, special.erfc),
    "erfcx": (1, lambda z: special.wofz(1j * z)),
    "gamma": (1, special.gamma),
    "loggamma": (1, special.loggamma),
}

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def compile_expression(text: str, parameters: Mapping[str, float] | None = None) -> Transfer:
    """Turn an expression of s into a function of a complex array.

    Parameters
    ----------
    text : str
        Numbers, ``s``, named parameters, ``pi``, ``e``, ``+ - * / **``, parentheses and the
        functions of `FUNCTIONS` (any case: ``K0`` is ``k0``). ``i0e(z)`` is e^(−z)·I0(z) and
        ``k0e(z)`` is e^z·K0(z): products of them do not overflow.
    parameters : mapping of str to float
        Values of the named parameters.

    Returns
    -------
    callable
        Complex ndarray of shape (m,) in, the same shape out; non-finite where the expression is.

    Raises
    ------
    ExpressionError
        Anything else in `text`; the message shows the column, counted from 1, and near names.
    """
    parameters = dict(parameters or {})
    for name in parameters:
        if name in RESERVED or not name.isidentifier():
            raise ExpressionError(f"parameter {name!r}: the name is taken or is no name")
    node = _Compiler(text, parameters).compiled()

    def transfer(s: ComplexArray) -> ComplexArray:
        s = np.asarray(s, dtype=np.complex128)
        with np.errstate(all="ignore"):
            return np.array(np.broadcast_to(node(s), s.shape), dtype=np.complex128)

    return transfer


class _Compiler:
    """One walk over the syntax tree; every node becomes a function of s."""

    def __init__(self, text: str, parameters: Mapping[str, float]) -> None:
        self.text = text.strip()
        self.names = {**CONSTANTS, **parameters}

    def compiled(self) -> Node:
        if len(self.text) > MAX_CHARACTERS:
            raise ExpressionError(f"expression longer than {MAX_CHARACTERS} characters")
        if not self.text:
            raise ExpressionError("empty expression")
        try:
            tree = ast.parse(self.text, mode="eval").body
        except SyntaxError as error:
            raise self._error(error.msg, (error.offset or 1) - 1) from None
        except (RecursionError, MemoryError):
            raise ExpressionError("expression nested too deeply") from None
        except ValueError as error:  # a null byte, an integer of thousands of digits
            raise ExpressionError(f"{error}") from None
        if _depth(tree) > MAX_DEPTH:
            raise ExpressionError("expression nested too deeply")
        return self._node(tree)

    def _node(self, tree: ast.expr) -> Node:
        match tree:
            case ast.Constant():
                return self._number(tree)
            case ast.Name():
                return self._name(tree)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self._node(operand)
                return lambda s: -inner(s)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._node(operand)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                apply, a, b = _BINARY[type(op)], self._node(left), self._node(right)
                return lambda s: apply(a(s), b(s))
            case ast.BinOp(op=ast.BitXor(), left=left):
                raise self._error("a power is written **", left.end_col_offset or 0)
            case ast.Call(func=ast.Name()):
                return self._call(tree)
        raise self._error("not allowed in an expression", tree.col_offset)

    def _number(self, tree: ast.Constant) -> Node:
        if isinstance(tree.value, bool) or not isinstance(tree.value, int | float):
            raise self._error("not a real number", tree.col_offset)
        try:
            value = np.complex128(tree.value)
        except OverflowError:
            raise self._error("number too large", tree.col_offset) from None
        return lambda s: value

    def _name(self, tree: ast.Name) -> Node:
        if tree.id == "s":
            return lambda s: s
        if tree.id not in self.names:
            hint = _hint(tree.id, ("s", *self.names))
            raise self._error(f"unknown name {tree.id!r}{hint}", tree.col_offset)
        value = np.complex128(self.names[tree.id])
        return lambda s: value

    def _call(self, tree: ast.Call) -> Node:
        assert isinstance(tree.func, ast.Name)
        name = tree.func.id.lower()
        if name not in FUNCTIONS:
            hint = _hint(name, FUNCTIONS) or f"; one of {', '.join(FUNCTIONS)}"
            raise self._error(f"unknown function {tree.func.id!r}{hint}", tree.col_offset)
        count, function = FUNCTIONS[name]
        if tree.keywords or len(tree.args) != count:
            plural = "" if count == 1 else "s"
            raise self._error(f"{name} takes {count} argument{plural}", tree.col_offset)
        arguments = [self._node(argument) for argument in tree.args]
        return lambda s: function(*(argument(s) for argument in arguments))

    def _error(self, message: str, offset: int) -> ExpressionError:
        # `ast` counts bytes; an expression that is not ASCII is an error near that place anyway.
        around = self.text[max(offset - 10, 0) : offset + 15]
        return ExpressionError(f"column {offset + 1}, near {around!r}: {message}")


def _depth(tree: ast.expr) -> int:
    level: list[ast.AST] = [tree]
    depth = 0
    while level:
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        depth += 1
    return depth


def _hint(name: str, known: Iterable[str]) -> str:
    near = get_close_matches(name, list(known), n=2, cutoff=0.5)
    return f" (did you mean {' or '.join(near)}?)" if near else ""
