"""The state of a stream on disk, so that a restart goes on without a step."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from thermaltool.documents import CHECKPOINT, Part, atomic_output, finite, mapping, text
from thermaltool.errors import ModelError, OutputError
from thermaltool.runtime.pipe import LAST_WORD

REMEDY = "remove the file to start from rest"


@dataclass(frozen=True)
class Kept:
    """A state that was read.

    Attributes
    ----------
    state : dict
    age : float [s]
        By the wall clock; below zero where that was put back.
    damage : str
        What is wrong with the newest state, where this is the one before it; else empty.
    """

    state: dict[str, Any]
    age: float
    damage: str = ""


@dataclass
class Checkpoint:
    """A file that always holds one whole state, beside the one before it.

    Attributes
    ----------
    path : str
        The state before the newest is in ``PATH.previous``.
    design : str
        Digest of the estimator.
    wall : callable
        Seconds since 1970.
    """

    path: str
    design: str
    wall: Callable[[], float] = time.time
    _writer: threading.Thread | None = field(default=None, init=False)
    _waiting: bytes | None = field(default=None, init=False)
    _writing: bool = field(default=False, init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    _error: OutputError | None = field(default=None, init=False)

    @property
    def previous(self) -> str:
        """Where the state before the newest is."""
        return self.path + ".previous"

    def check_folder(self) -> None:
        """Raise OutputError where no state could be kept."""
        if os.path.exists(self.path) and not os.path.isfile(self.path):
            raise OutputError(f"{self.path}: not a file that could hold a state")
        if not os.path.isdir(os.path.dirname(os.path.abspath(self.path))):
            raise OutputError(f"{self.path}: the folder does not exist")

    def load(self) -> Kept | None:
        """The newest state that is whole, or None where there is no file yet.

        Raises
        ------
        ModelError
            Not a checkpoint, or one of another estimator, and no whole one before it.
        OutputError
            It cannot be read.
        """
        if not os.path.exists(self.path):
            return None
        try:
            return self._read(self.path)
        except ModelError as error:
            with contextlib.suppress(ModelError, OutputError):
                before = self._read(self.previous)
                return Kept(before.state, before.age, str(error))
            raise ModelError(f"{error}; {REMEDY}") from error

    def _read(self, path: str) -> Kept:
        try:
            content = Path(path).read_bytes().decode(errors="replace")
            written = os.stat(path).st_mtime
        except OSError as error:
            raise OutputError(f"{path}: {error.strerror}") from error
        document = CHECKPOINT.loads(content, path)
        part = Part(document, path)
        # The first version had neither seal nor time.
        if document["version"] > 1:
            CHECKPOINT.check_seal(document, path)
            written = part.read("written_s", finite)
        if part.read("design_sha256", text) != self.design:
            raise ModelError(f"{path}: a checkpoint of another model or design")
        return Kept(part.read("state", mapping), self.wall() - written)

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
        self._writer = threading.Thread(target=self._write_waiting, daemon=True)
        self._writer.start()

    def close(self, state: dict[str, Any], patience: float = LAST_WORD) -> None:
        """Write the last state and wait for it, no longer than `patience` [s]; raises as `save`."""
        self._error = None
        self.save(state)
        assert self._writer is not None
        self._writer.join(patience)
        if self._writer.is_alive():
            raise OutputError(f"{self.path}: the disk stalls, the last state is not written")
        self._raise()

    def _text(self, state: dict[str, Any]) -> bytes:
        body = {"design_sha256": self.design, "state": state, "written_s": self.wall()}
        return CHECKPOINT.dumps(body, indent=None).encode()

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
            self._keep_previous()
            with atomic_output(self.path) as stream:
                stream.write(text)
        except OutputError as error:
            self._error = error

    def _keep_previous(self) -> None:
        """The newest state gets its second name; where links are not possible, there is none."""
        beside = self.previous + ".new"
        with contextlib.suppress(OSError):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(beside)
            os.link(self.path, beside)
            os.replace(beside, self.previous)

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error
