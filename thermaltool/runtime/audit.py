"""A log of what a stream did and why: one JSON object a line, appended, never rewritten."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from typing import Any

from thermaltool.errors import OutputError
from thermaltool.runtime.line_writer import LineWriter

# Every line of such a file begins so.
BEGIN = b'{"utc": '


class Audit:
    """A file to which events are appended; without a path it keeps nothing.

    Parameters
    ----------
    path : str or None

    Raises
    ------
    OutputError
        The file cannot be opened for appending.
    """

    def __init__(self, path: str | None) -> None:
        self._descriptor, self._lines = -1, None
        if path is None:
            return
        # A pipe that nobody reads is refused at once.
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NONBLOCK
        try:
            if os.path.isfile(path) and os.path.getsize(path):
                with open(path, "rb") as before:
                    if not before.read(len(BEGIN)).startswith(BEGIN):
                        raise OutputError(f"{path}: not an audit log, nothing is appended to it")
            self._descriptor = os.open(path, flags, 0o644)
            os.set_blocking(self._descriptor, True)
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(f"{path}: {error.strerror}") from error
        self._lines = LineWriter(self._descriptor)

    def add(self, event: str, **more: Any) -> None:
        """Append an event with the time of day (UTC) and whatever belongs to it."""
        if self._lines is not None:
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            self._lines.write(json.dumps({"utc": now, "event": event, **more}))

    def close(self) -> None:
        """Wait a moment for what is on its way."""
        if self._lines is not None and self._lines.close():
            os.close(self._descriptor)
            self._lines = None
