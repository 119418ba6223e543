"""What can go wrong at the border. Each error is one line that names its place.

Every class also subclasses the builtin that a caller of the library would expect.
"""

from __future__ import annotations


class ThermalToolError(Exception):
    """Anything the user can mend. The command line prints it in one line and exits with 1."""


class LogError(ThermalToolError, ValueError):
    """A log that cannot be read or does not fit.

    Parameters
    ----------
    message : str
        What is wrong, and the mend where there is one.
    file, line, column : optional
        Where: shown as ``file:line: column: message``. `line` counts from 1, header included.
    """

    def __init__(
        self,
        message: str,
        file: str | None = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.message, self.file, self.line, self.column = message, file, line, column
        place = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(f"{place}{column + ': ' if column else ''}{message}")


class UnitError(ThermalToolError, ValueError):
    """A column name without a known unit, or quantities that do not go together."""


class ModelError(ThermalToolError, ValueError):
    """A model document that cannot be read, or cannot do what is asked of it."""


class FitError(ThermalToolError, ArithmeticError):
    """A calibration or a design that has no usable answer on these data.

    Parameters
    ----------
    message : str
    channel : str
        The output that the message names; empty where it names none.
    """

    def __init__(self, message: str, channel: str = "") -> None:
        super().__init__(message)
        self.channel = channel


class DataError(FitError):
    """Data of which no structure has a fit."""


class OutputError(ThermalToolError, OSError):
    """A result that could not be written. What existed before is still there."""


class ThermalToolWarning(UserWarning):
    """What a result is to be read with: a model that extrapolates, a pause in a log."""


def counted(number: int, noun: str) -> str:
    """A number of things, as messages say it: "1 row", "2 rows".

    Parameters
    ----------
    number : int
    noun : str
        Of one thing.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
