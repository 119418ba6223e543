"""Values of options that are more than one number or word."""

from __future__ import annotations

from math import inf
from typing import Any

import click


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
