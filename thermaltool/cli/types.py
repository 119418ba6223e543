"""Values of options: files, finite numbers, and what is more than one number or word."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from math import inf, isfinite
from typing import Any

import click

from thermaltool.units import UNITS

# From the tenth order on the search leaves the range of numbers (--continuous first).
MAX_TRANSFER_ORDER = 9
# As far as `order` goes.
MAX_ARMA_ORDER = 200


class InputPath(click.Path):
    """A readable file, or ``-`` for stdin; a terminal on stdin is a usage error."""

    name = "file"

    def __init__(self) -> None:
        super().__init__(exists=False, dir_okay=True, allow_dash=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "-" and sys.stdin is not None and sys.stdin.isatty():
            self.fail("stdin is a terminal: name a file or pipe a log in", param, ctx)
        return super().convert(value, param, ctx)


def _finite(number: Any, value: Any, kind: click.ParamType, *place: Any) -> Any:
    if not isfinite(number):
        kind.fail(f"{value!r} is not a finite number", *place)
    return number


class Number(click.types.FloatParamType):
    """A number; NaN and infinity are none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return _finite(super().convert(value, param, ctx), value, self, param, ctx)


class NumberRange(click.FloatRange):
    """A number within bounds; NaN, which no bound keeps out, and infinity are none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return _finite(super().convert(value, param, ctx), value, self, param, ctx)


def _seconds(kind: click.ParamType, value: Any, *place: Any) -> Any:
    """A time that is typed with its unit, in seconds; anything else as it is."""
    found = re.fullmatch(r"\s*(\S*\d\.?)\s*([a-zA-Zµ]+)\s*", str(value))
    if found is None:
        return value
    dimension, factor = UNITS.get(found[2], ("", 0.0))
    if dimension != "time":
        kind.fail(f"{value!r} is not a time, like 30s, 10min or 8h", *place)
    return NUMBER.convert(found[1], *place) * factor


class Seconds(Number):
    """A time in seconds, or with its unit: ``30s``, ``10min``, ``8h``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """In seconds."""
        return super().convert(_seconds(self, value, param, ctx), param, ctx)


class SecondsRange(NumberRange):
    """A time within bounds [s], typed as `Seconds`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """In seconds."""
        return super().convert(_seconds(self, value, param, ctx), param, ctx)


NUMBER, SECONDS = Number(), Seconds()
POSITIVE, NOT_NEGATIVE = NumberRange(min=0, min_open=True), NumberRange(min=0)
DURATION, DELAY = SecondsRange(min=0, min_open=True), SecondsRange(min=0)
# A part of a whole, neither nothing nor all of it; and a weight of the past, which may be all.
PROPER_SHARE = NumberRange(min=0, max=1, min_open=True, max_open=True)
FORGETTING = NumberRange(min=0, max=1, min_open=True)


class ValueRefusedError(ValueError):
    """What is wrong with a value that has the right form."""


class Parsed(click.ParamType):
    """A value that `parse` reads off its text.

    Attributes
    ----------
    name : str
        The form, for the help.
    form : str
        The form as a message says it: what the text "is not", `name` by default.
    """

    form = ""

    def parse(self, text: str) -> Any:
        """The value; ValueError where the text has another form or says what cannot be."""
        raise NotImplementedError

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        # A number of a config file is one as it would be typed.
        if not isinstance(value, str | int | float):
            return value
        try:
            return self.parse(str(value))
        except ValueRefusedError as error:
            self.fail(f"{value!r}{error}", param, ctx)
        except ValueError:
            self.fail(f"{value!r} is not {self.form or self.name}", param, ctx)


class TimeGrid(Parsed):
    """START:STOP:COUNT[:log] as a tuple (start, stop, count, is_log)."""

    name = "start:stop:count[:log]"
    form = "START:STOP:COUNT or START:STOP:COUNT:log"

    def parse(self, text: str) -> tuple[float, float, int, bool]:
        start, stop, count, *scale = text.split(":")
        grid = float(start), float(stop), int(count), scale == ["log"]
        if scale not in ([], ["log"], ["lin"]) or not 0 < grid[0] <= grid[1] < inf or grid[2] < 1:
            raise ValueRefusedError(": needs 0 < START <= STOP, COUNT >= 1, log or lin")
        return grid


class Assignment(Parsed):
    """NAME=VALUE as a tuple (name, value)."""

    name, form = "name=value", "NAME=NUMBER"

    def parse(self, text: str) -> tuple[str, float]:
        name, _, number = text.partition("=")
        return name.strip(), float(number)


class ControlType(Parsed):
    """CHANNEL, or CHANNEL:MAX, as a tuple (channel, maximum or None)."""

    name, form = "channel[:max]", "CHANNEL or CHANNEL:MAX"

    def parse(self, text: str) -> tuple[str, float | None]:
        name, colon, number = text.partition(":")
        return name.strip(), float(number) if colon else None


class Levels(Parsed):
    """Numbers parted by commas, as a tuple."""

    name = "x1,x2,..."

    def parse(self, text: str) -> tuple[float, ...]:
        return tuple(map(float, text.split(",")))


class IntervalType(Parsed):
    """LOW:HIGH, or CHANNEL=LOW:HIGH; an end left empty is open."""

    def __init__(self, channel: bool = False) -> None:
        self.channel, self.name = channel, "CHANNEL=LOW:HIGH" if channel else "LOW:HIGH"

    def parse(self, text: str) -> Any:
        channel, equals, interval = text.rpartition("=")
        low, colon, high = interval.partition(":")
        ends = float(low or "-inf"), float(high or "inf")
        if not (colon and ends[0] <= ends[1] and bool(equals) == self.channel):
            raise ValueError
        return (channel, ends) if self.channel else ends


class SizeType(Parsed):
    """Bytes, with a decimal or binary prefix or without."""

    name, form = "BYTES", "a size: 500MB, 20GB or 4GiB"

    def parse(self, text: str) -> int:
        found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(?:([kKMGT])(i?))?B?\s*", text, re.ASCII)
        if found is None:
            raise ValueError
        number, prefix, binary = found.groups()
        size = float(number) * (1024 if binary else 1000) ** " KMGT".index((prefix or " ").upper())
        if not 1 <= size < 2**63:
            raise ValueRefusedError(": needs 1 byte or more, and fewer than 2^63")
        return int(size)


class SafeType(Parsed):
    """The safe setpoint: a number, or ``hold`` for the one before."""

    name = "hold|zero|VALUE"

    def parse(self, text: str) -> float | str:
        if text == "hold":
            return text
        number = 0.0 if text == "zero" else float(text)
        if not isfinite(number):
            raise ValueError
        return number


class RateType(Parsed):
    """A random-walk rate above 0, or where it comes from."""

    name = "likelihood|design|RATE"

    def parse(self, text: str) -> float | str:
        if text in ("likelihood", "design"):
            return text
        number = float(text)
        if not 0 < number < inf:
            raise ValueError
        return number


class AmountType(Parsed):
    """A number, or one with its unit; it stays a text, for its unit depends on the setpoint.

    Attributes
    ----------
    above : bool
        Whether 0 is none.
    """

    def __init__(self, name: str, above: bool = False) -> None:
        self.name, self.above = name, above

    def parse(self, text: str) -> str:
        from thermaltool.errors import UnitError
        from thermaltool.units import parse_quantity

        if text.strip().lower().lstrip("+-") in ("nan", "inf", "infinity"):
            raise ValueRefusedError(" is not a finite number")
        try:
            value, _ = parse_quantity(text.removesuffix("/s") if self.above else text)
        except UnitError as error:
            raise ValueRefusedError(f": {error}") from error
        if value < 0 or (self.above and not value) or not isfinite(value):
            raise ValueRefusedError(f" is not {'above 0' if self.above else '0 or more'}")
        return text


class PositionType(Parsed):
    """Where an actuator stands: ``NAME=VALUE``, or a number for every one."""

    name = "[NAME=]VALUE"

    def parse(self, text: str) -> tuple[str, float]:
        name, _, value = text.rpartition("=")
        number = float(value)
        if not isfinite(number):
            raise ValueError
        return name, number


def positions_of(given: Sequence[tuple[str, float]]) -> dict[str, float] | float | None:
    """What `PositionType` gave: one number for all, a number for each name, or nothing."""
    names = [name for name, _ in given]
    if len(set(names)) < len(names) or ("" in names and len(names) > 1):
        raise click.UsageError("--at takes one number for all, or one for each NAME")
    if names == [""]:
        return given[0][1]
    return dict(given) or None


class PairsType(Parsed):
    """Numbers A:B, several of them with commas between."""

    def __init__(self, name: str, single: bool = False) -> None:
        self.name, self.single = name, single

    def parse(self, text: str) -> Any:
        pairs = [tuple(map(float, part.split(":"))) for part in text.split(",")]
        if any(len(pair) != 2 for pair in pairs) or (self.single and len(pairs) > 1):
            raise ValueError
        return pairs[0] if self.single else pairs


class Order(Parsed):
    """P or P,Q."""

    name = "P,Q"

    def parse(self, text: str) -> tuple[int, int]:
        p, comma, q = text.partition(",")
        if not (text.isascii() and p.strip().isdigit() and (q.strip().isdigit() or not comma)):
            raise ValueError
        if max(int(p), int(q or 0)) > MAX_ARMA_ORDER:
            raise ValueRefusedError(f": orders go up to {MAX_ARMA_ORDER}")
        return int(p), int(q or 0)


class ErrorModelType(Parsed):
    """``direct``, or the order of an ARMA model."""

    name = "direct|P|P,Q"

    def parse(self, text: str) -> str | tuple[int, int]:
        if text == "direct":
            return text
        p, _, q = text.partition(",")
        order = int(p), int(q or 0)
        if min(order) < 0 or not any(order):
            raise ValueError
        return order


class TransferOrder(Parsed):
    """nb,nf,nk as a tuple, or None for auto."""

    name = "nb,nf,nk"

    def parse(self, text: str) -> tuple[int, int, int] | None:
        if text == "auto":
            return None
        parts = [part.strip() for part in text.split(",")]
        if len(parts) != 3 or not all(part.isascii() and part.isdigit() for part in parts):
            raise ValueRefusedError(f" is neither {self.name} nor auto")
        nb, nf, nk = map(int, parts)
        if max(nb, nf) > MAX_TRANSFER_ORDER:
            raise ValueRefusedError(f": nb and nf go up to {MAX_TRANSFER_ORDER}")
        return nb, nf, nk


class DeadTime(Parsed):
    """Seconds, or "auto"."""

    name = "SECONDS|auto"

    def parse(self, text: str) -> float | str:
        if text == "auto":
            return text
        seconds: float = SECONDS.convert(text, None, None)
        if seconds < 0:
            raise ValueRefusedError(" is below 0")
        return seconds


class Abscissa(Parsed):
    """A rate [1/s], or None for auto."""

    name, form = "RATE|auto", "a number or auto"

    def parse(self, text: str) -> float | None:
        if text == "auto":
            return None
        rate: float = NUMBER.convert(text, None, None)
        return rate
