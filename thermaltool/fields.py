"""Reading a JSON document field by field: what cannot be read is told with its place in the file.

A reader takes a value of the document and returns what a model holds, or raises `ModelError`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any, Literal

from thermaltool.errors import ModelError


class Part:
    """An object of the file, which names the field that cannot be read."""

    def __init__(self, value: Any, place: str = "") -> None:
        self._value, self._place = value, place
        if not isinstance(value, dict):
            raise ModelError(f"{place}: not an object: {value!r:.60}")

    def read(self, field: str, reader: Callable[[Any], Any], *absent: Any) -> Any:
        """What `reader` makes of a field; `absent` where it is null or not there, if given."""
        value = self._value.get(field)
        if absent and value is None:
            return absent[0]
        if field not in self._value:
            raise ModelError(f"{self._place}{': ' if self._place else ''}{field!r} is missing")
        return told(reader, value, self._field(field))

    def parts(self, field: str, *absent: Any) -> list[Part]:
        """The objects of a list."""
        return [
            Part(each, f"{self._field(field)}[{k}]")
            for k, each in enumerate(self.read(field, items, *absent))
        ]

    def part(self, field: str) -> Part:
        """The object in a field."""
        return Part(self.read(field, mapping), self._field(field))

    def as_whole(self, reader: Callable[[Any], Any]) -> Any:
        """What `reader` makes of the object."""
        return told(reader, self._value, self._place)

    def _field(self, field: str) -> str:
        return f"{self._place}.{field}" if self._place else field


def told(reader: Callable[[Any], Any], value: Any, place: str) -> Any:
    """What `reader` makes of a value, or where in the file it cannot."""
    try:
        return reader(value)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from error
    except KeyError as error:
        raise ModelError(f"{place}: {error.args[0]!r} is missing") from error
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{place}: cannot be read: {json.dumps(value):.60}") from error


def one_of(known: tuple[str, ...]) -> Callable[[Any], Any]:
    """A reader of one of several words."""

    def reader(value: Any) -> Any:
        if value not in known:
            raise ModelError(f"{value!r:.60} is none of {', '.join(known)}")
        return value

    return reader


def text(value: Any) -> str:
    """A name."""
    if not isinstance(value, str) or not value:
        raise ModelError(f"not a name: {value!r:.60}")
    return value


def items(value: Any) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise ModelError(f"not a list: {value!r:.60}")
    return value


def names(value: Any) -> tuple[str, ...]:
    """A list of names."""
    return tuple(map(text, items(value)))


def mapping(value: Any) -> dict[str, Any]:
    """An object."""
    if not isinstance(value, dict):
        raise ModelError(f"not an object: {value!r:.60}")
    return value


def finite(value: Any) -> float:
    """A number, neither NaN nor infinity."""
    number = isinstance(value, float | int) and not isinstance(value, bool)
    # Beyond the largest float an integer is no number of a model.
    if not number or not abs(value) <= sys.float_info.max:
        raise ModelError(f"not a finite number: {value!r:.60}")
    return float(value)


def above_zero(value: Any) -> float:
    """A number above zero."""
    if not (number := finite(value)) > 0:
        raise ModelError(f"not above 0: {number:g}")
    return number


def rest(value: Any) -> float | Literal["first"]:
    """A number, or "first" for the first value of a log."""
    return "first" if value == "first" else finite(value)


def pair(values: Any) -> tuple[float, float]:
    """A low and a high number."""
    if not isinstance(values, list) or len(values) != 2:
        raise ModelError(f"not two numbers: {values!r:.60}")
    low, high = map(finite, values)
    if low > high:
        raise ModelError(f"{low:g} is above {high:g}")
    return low, high
