"""The state of a stream on disk, so that a restart goes on without a step."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermaltool.documents import CHECKPOINT, Part, atomic_output, mapping, text
from thermaltool.errors import ModelError, OutputError

REMEDY = "remove the file to start from rest"


def design_digest(design: Mapping[str, Any]) -> str:
    """Identifies an estimator: a state belongs to one."""
    return hashlib.sha256(json.dumps(design, sort_keys=True).encode()).hexdigest()


@dataclass
class Checkpoint:
    """A file that always holds one whole state.

    Attributes
    ----------
    path : str
    design : str
        Digest of the estimator.
    """

    path: str
    design: str
    _writer: threading.Thread | None = field(default=None, init=False)
    _waiting: bytes | None = field(default=None, init=False)
    _writing: bool = field(default=False, init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    _error: OutputError | None = field(default=None, init=False)

    def load(self) -> dict[str, Any] | None:
        """The state, or None where there is no file yet.

        Raises
        ------
        ModelError
            Not a checkpoint, or one of another estimator.
        OutputError
            The folder is missing: no state could be kept there.
        """
        if Path(self.path).exists() and not Path(self.path).is_file():
            raise OutputError(f"{self.path}: not a file that could hold a state")
        try:
            content = Path(self.path).read_bytes().decode(errors="replace")
        except FileNotFoundError:
            if not Path(self.path).absolute().parent.is_dir():
                raise OutputError(f"{self.path}: the folder does not exist") from None
            return None
        except OSError as error:
            raise OutputError(f"{self.path}: {error.strerror}") from error
        try:
            part = Part(CHECKPOINT.loads(content, self.path), self.path)
            if part.read("design_sha256", text) != self.design:
                raise ModelError(f"{self.path}: a checkpoint of another model or design")
            return part.read("state", mapping)
        except ModelError as error:
            raise ModelError(f"{error}; {REMEDY}") from error

    def save(self, state: dict[str, Any]) -> None:
        """Write `state` whole, in the background: a slow disk does not keep the stream waiting.

        While an earlier one is still being written, the newest waits; those between are left out.

        Raises
        ------
        OutputError
            An earlier save failed.
        """
        self._raise()
        with self._lock:
            self._waiting = self._text(state)
            if self._writing:
                return
            self._writing = True
        self._writer = threading.Thread(target=self._write_waiting)
        self._writer.start()

    def close(self, state: dict[str, Any]) -> None:
        """Write the last state and wait for it; raises as `save`."""
        if self._writer is not None:
            self._writer.join()
        self._error = None
        self._write(self._text(state))
        self._raise()

    def _text(self, state: dict[str, Any]) -> bytes:
        document = CHECKPOINT.wrap({"design_sha256": self.design, "state": state})
        return json.dumps(document, sort_keys=True, allow_nan=False).encode() + b"\n"

    def _write_waiting(self) -> None:
        while True:
            with self._lock:
                text, self._waiting = self._waiting, None
                if text is None:
                    self._writing = False
                    return
            self._write(text)

    def _write(self, text: bytes) -> None:
        try:
            with atomic_output(self.path) as stream:
                stream.write(text)
        except OutputError as error:
            self._error = error

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error
