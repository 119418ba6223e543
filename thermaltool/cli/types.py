"""Values of options that are more than one number or word."""

from __future__ import annotations

import contextlib
from math import inf
from typing import Any

import click

from thermaltool.cli.options import NUMBER

# From the tenth order on the search leaves the range of numbers (--continuous first).
MAX_TRANSFER_ORDER = 9


class TimeGrid(click.ParamType):
    """START:STOP:COUNT[:log] as a tuple (start, stop, count, is_log)."""

    name = "start:stop:count[:log]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, tuple):
            return value
        try:
            start, stop, count, *scale = value.split(":")
            grid = float(start), float(stop), int(count), scale == ["log"]
        except ValueError:
            self.fail(f"{value!r} is not START:STOP:COUNT or START:STOP:COUNT:log", param, ctx)
        if scale not in ([], ["log"], ["lin"]) or not 0 < grid[0] <= grid[1] < inf or grid[2] < 1:
            self.fail(f"{value!r}: needs 0 < START <= STOP, COUNT >= 1, log or lin", param, ctx)
        return grid


class Assignment(click.ParamType):
    """NAME=VALUE as a tuple (name, value)."""

    name = "name=value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, tuple):
            return value
        name, _, number = value.partition("=")
        try:
            return name.strip(), float(number)
        except ValueError:
            self.fail(f"{value!r} is not NAME=NUMBER", param, ctx)


class Levels(click.ParamType):
    """Numbers parted by commas, as a tuple."""

    name = "x1,x2,..."

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        try:
            return tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is not {self.name}", param, ctx)


class IntervalType(click.ParamType):
    """LOW:HIGH, or CHANNEL=LOW:HIGH; an end left empty is open."""

    def __init__(self, channel: bool = False) -> None:
        self.channel, self.name = channel, "CHANNEL=LOW:HIGH" if channel else "LOW:HIGH"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        channel, equals, interval = value.rpartition("=")
        low, colon, high = interval.partition(":")
        with contextlib.suppress(ValueError):
            ends = float(low or "-inf"), float(high or "inf")
            if colon and ends[0] <= ends[1] and bool(equals) == self.channel:
                return (channel, ends) if self.channel else ends
        self.fail(f"{value!r} is not {self.name}", param, ctx)


class SafeType(click.ParamType):
    """The safe setpoint: a number, or ``hold`` for the one before."""

    name = "hold|zero|VALUE"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        with contextlib.suppress(ValueError):
            number = 0.0 if value == "zero" else float(value)
            if abs(number) < float("inf"):
                return number
        return value if value == "hold" else self.fail(f"{value!r} is not {self.name}", param, ctx)


class PairsType(click.ParamType):
    """Numbers A:B, several of them with commas between."""

    def __init__(self, name: str, single: bool = False) -> None:
        self.name, self.single = name, single

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        with contextlib.suppress(ValueError):
            pairs = [tuple(map(float, part.split(":"))) for part in value.split(",")]
            if all(len(pair) == 2 for pair in pairs) and (len(pairs) == 1 or not self.single):
                return pairs[0] if self.single else pairs
        self.fail(f"{value!r} is not {self.name}", param, ctx)


class ErrorModelType(click.ParamType):
    """``direct``, or the order of an ARMA model."""

    name = "direct|P|P,Q"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "direct" or not isinstance(value, str):
            return value
        with contextlib.suppress(ValueError):
            p, _, q = value.partition(",")
            if int(p) >= 0 <= int(q or 0) and int(p) + int(q or 0):
                return int(p), int(q or 0)
        self.fail(f"{value!r} is not {self.name}", param, ctx)


class TransferOrder(click.ParamType):
    """nb,nf,nk as a tuple, or None for auto."""

    name = "nb,nf,nk"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        parts = [part.strip() for part in value.split(",")]
        if value == "auto":
            return None
        if len(parts) != 3 or not all(part.isascii() and part.isdigit() for part in parts):
            self.fail(f"{value!r} is neither {self.name} nor auto", param, ctx)
        nb, nf, nk = map(int, parts)
        if max(nb, nf) > MAX_TRANSFER_ORDER:
            self.fail(f"{value!r}: nb and nf go up to {MAX_TRANSFER_ORDER}", param, ctx)
        return nb, nf, nk


class DeadTime(click.ParamType):
    """Seconds, or "auto"."""

    name = "SECONDS|auto"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "auto" or not isinstance(value, str):
            return value
        seconds = NUMBER.convert(value, param, ctx)
        if seconds < 0:
            self.fail(f"{value!r} is below 0", param, ctx)
        return seconds
