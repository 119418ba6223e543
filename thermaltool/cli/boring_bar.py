"""``thermaltool plant boring-bar``: a cut in open loop, or one answered line by line."""

from __future__ import annotations

import os
import stat
from typing import IO

import click
import numpy as np

from thermaltool.cli.plant import clock
from thermaltool.errors import LogError
from thermaltool.logs import read_log, write_table
from thermaltool.plants.boring_bar import PARTS, CutRecord, build

COMMAND = "U_command_V"


def write_cut(
    part: str,
    speed: float,
    duration: float,
    seed: int,
    commands: str | None,
    output: str,
    form: str | None,
) -> None:
    """Cut, and write the log; see the options of ``plant``."""
    bar = build()
    samples = len(clock(duration, bar.parameters.period)) - 1
    if commands is not None and stat.S_ISFIFO(os.stat(commands).st_mode):
        if output == "-":
            raise click.UsageError("-o FILE is needed: stdout carries the lines of the loop")
        period = bar.parameters.period
        # The header goes out first: the controller opens its end when it has something to say.
        click.echo("time_s,n_spindle_rpm,e_tool_um")
        with open(commands, encoding="utf-8") as answers:
            loop = _Loop(answers, speed, period)
            record = bar.cut(PARTS[part], speed, samples, loop.answer, seed)
        if loop.fault:  # what was cut until then is not lost
            write_table(record.columns(speed), output, form)
            raise LogError(f"{loop.fault}: {record.time.size} of {samples} samples are in {output}",
                           commands)  # fmt: skip
    else:
        record = _open_loop(part, speed, samples, seed, commands)
    write_table(record.columns(speed), output, form)


def _open_loop(part: str, speed: float, samples: int, seed: int, commands: str | None) -> CutRecord:
    bar = build()
    if commands is None:
        return bar.cut(PARTS[part], speed, samples, seed=seed)
    given = read_log(commands, need=(COMMAND,)).column(COMMAND)
    held = np.concatenate([given, np.full(max(samples - len(given), 0), given[-1])])
    waiting = iter(held.tolist())
    return bar.cut(PARTS[part], speed, samples, lambda reading: next(waiting), seed)


class _Loop:
    """Lines out and commands in; `fault` tells why they have ended before the cut."""

    fault = ""

    def __init__(self, answers: IO[str], speed: float, period: float) -> None:
        self._answers, self._speed, self._period = answers, speed, period
        self._count = 0
        self._at = -1

    def answer(self, reading: float) -> float | None:
        try:
            click.echo(f"{self._count * self._period:.10g},{self._speed:g},{reading!r}")
        except BrokenPipeError:
            self.fault = "nobody reads the lines any more"
            return None
        self._count += 1
        fields = self._fields()
        if self._at < 0 and fields is not None:
            if COMMAND not in fields:
                raise LogError(f"no column {COMMAND}", self._answers.name)
            self._at = fields.index(COMMAND)
            fields = self._fields()
        if fields is None:
            self.fault = "the commands have ended before the cut"
            return None
        try:
            return float(fields[self._at])
        except (IndexError, ValueError):
            self.fault = f"line {self._count + 1} is no command"
            return None

    def _fields(self) -> list[str] | None:
        """Of one line; None where there is none any more."""
        line = self._answers.readline()
        return line.rstrip("\n").split(",") if line else None
