"""Logs as the commands that fit take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from thermaltool.cli.messages import warn_pauses
from thermaltool.errors import LogError

if TYPE_CHECKING:
    from thermaltool.logs import Log


def read_for_fit(
    name: str,
    need: Sequence[str],
    reading: Mapping[str, Any],
    subject: str,
    span: tuple[float | None, float | None] = (None, None),
    min_rows: int = 2,
    pause: str = "the drive is taken as held over it",
) -> Log:
    """A log over a `span` of time [s], with a word on what its pauses mean.

    Raises
    ------
    LogError
        As `read_log` with its options `reading`; too few rows to say anything of the `subject`.
    """
    from thermaltool.logs import read_log

    log = read_log(name, **reading, need=need).between(*span)
    if len(log) < min_rows:
        raise LogError(f"{len(log)} rows say nothing of a {subject}", log.name)
    warn_pauses(log, pause)
    return log
