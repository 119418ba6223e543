"""Replies as lines of the user's own pattern: G-code, a message of a controller."""

from __future__ import annotations

import string
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from thermaltool.errors import UnitError
from thermaltool.runtime.clocks import Stamp
from thermaltool.runtime.pipe import PIPE_BUF
from thermaltool.status import EXTRAPOLATES, WORDS
from thermaltool.units import converted, parse_channel

if TYPE_CHECKING:
    from thermaltool.runtime.process import Reply
    from thermaltool.runtime.sinks import ByteOutput

# Fields of the time beside those of the reply: as the lines have it, and in seconds.
TIMES = ("time", "time_s")
# Every field of a pattern has to take these: what a set point may be, and words of a status.
TRIAL_NUMBERS = (0.0, -1234.56789, 1e-9, -1e9, 1 / 3)
TRIAL_WORD = EXTRAPOLATES


class _Field(NamedTuple):
    """A text, then the value at `place` of what a reply holds, times `factor`, as `spec` says."""

    before: str
    place: int | None
    factor: float
    spec: str

    def text(self, values: Sequence[Any]) -> str:
        """The part of a line; nothing in the place of a value that is not known."""
        value = None if self.place is None else values[self.place]
        if value is None:
            return self.before
        if isinstance(value, float) and self.factor != 1.0:
            # Adding zero turns -0.0 into 0.0.
            value = value * self.factor + 0.0
        return self.before + format(value, self.spec)


class TemplateSink:
    """A line per reply, by a pattern with fields as Python formats them: ``Z={offset_z_mm:.4f}``.

    A field is a name that is written, in its unit or another of the same quantity, ``time`` as the
    lines have it, or ``time_s`` in seconds.

    Parameters
    ----------
    output : ByteOutput
    template : str
    names : sequence of str
        What is written behind the time.

    Raises
    ------
    ValueError
        A field that is not there, a format that it cannot take, none of the `names` in it, or a
        line that is too long to be written at once.
    """

    def __init__(self, output: ByteOutput, template: str | None, names: Sequence[str]) -> None:
        if template is None:
            raise ValueError("--to template needs the pattern of a line: --template TEXT")
        self._output = output
        self._fields = _fields(template, names)
        if not any(field.place is not None and field.place >= len(TIMES) for field in self._fields):
            raise ValueError(f"--template {template!r}: no set point in it, of {', '.join(names)}")
        for number in TRIAL_NUMBERS:
            values = [TRIAL_WORD if name in WORDS else number for name in names]
            self._try([(number, values)], template)

    def _try(self, replies: Sequence[Reply], template: str) -> None:
        try:
            length = len(self._text(*replies[0]).encode())
        except (ValueError, OverflowError, MemoryError) as error:
            raise ValueError(f"--template {template!a}: {error or 'too long'}") from error
        if length > PIPE_BUF:
            raise ValueError(f"--template: a line of {length} bytes, above {PIPE_BUF}")

    def open(self, names: Sequence[str]) -> None:
        """There is no header."""

    def write(self, replies: Sequence[Reply]) -> None:
        """One line each, at once."""
        self._output.write("".join([self._text(*reply) for reply in replies]).encode())

    def _text(self, time: float | str | None, values: Sequence[Any]) -> str:
        seconds = time.seconds if isinstance(time, Stamp) else time
        known = (None if time is None else str(time), seconds, *values)
        return "".join([field.text(known) for field in self._fields]) + "\n"

    def close(self) -> None:
        """Every line is out already."""


def other_fields(template: str, names: Sequence[str]) -> list[str]:
    """Fields of a pattern beside the time and `names`; ValueError where it is no pattern."""
    fields = {name: None for _, name, _, _ in _parsed(template) if name is not None}
    return [name for name in fields if _place(name, (*TIMES, *names)) is None]


def _parsed(template: str) -> list[tuple[str, str | None, str | None, str | None]]:
    try:
        return list(string.Formatter().parse(template))
    except ValueError as error:
        raise ValueError(f"--template {template!a}: {error}") from error


def _fields(template: str, names: Sequence[str]) -> list[_Field]:
    known = (*TIMES, *names)
    fields = []
    for before, name, spec, conversion in _parsed(template):
        if name is None:
            fields.append(_Field(before, None, 1.0, ""))
            continue
        if conversion or (name == "time" and spec):
            raise ValueError(f"--template: {{{name}}} is written as it is: no {conversion or spec}")
        fields.append(_Field(before, *_found(name, known), spec or ""))
    return fields


def _found(name: str, known: Sequence[str]) -> tuple[int, float]:
    """Which value a field is, and times what; ValueError where it is none."""
    if (found := _place(name, known)) is not None:
        return found
    raise ValueError(f"--template: no field {name!r}: there are {', '.join(known)}")


def _place(name: str, known: Sequence[str]) -> tuple[int, float] | None:
    if name in known:
        return known.index(name), 1.0
    for place, other in enumerate(known[len(TIMES) :], len(TIMES)):
        if (factor := _factor(name, other)) is not None:
            return place, factor
    return None


def _factor(name: str, other: str) -> float | None:
    """From a channel to the same one in another unit; None where it is not the same one."""
    try:
        wanted, own = parse_channel(name), parse_channel(other)
    except UnitError:
        return None
    if (wanted.quantity, wanted.place) != (own.quantity, own.place):
        return None
    return converted(1.0, own.unit, wanted.unit)
