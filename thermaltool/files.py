"""Writing files so that nothing that existed is lost."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
from collections.abc import Iterator
from typing import BinaryIO

from thermaltool.errors import OutputError


@contextlib.contextmanager
def atomic_output(target: str) -> Iterator[BinaryIO]:
    """Open `target` for bytes; it appears whole when the block ends, or not at all.

    ``-`` is stdout. The data go to a temporary file in the same folder, are synced, and take the
    target's name with `os.replace`; when the block fails the old file stays as it was. Devices and
    pipes (``/dev/full``, a FIFO) cannot be replaced and are written directly.

    Raises
    ------
    OutputError
        Folder missing or read-only, disk full. `BrokenPipeError` passes: the reader has left.
    """
    if target == "-":
        if sys.stdout is None:
            raise OutputError("<stdout>: closed")
        try:
            yield sys.stdout.buffer
            sys.stdout.buffer.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            _discard_stdout()
            raise OutputError(f"<stdout>: {error.strerror}") from error
        return
    # A symbolic link stays one: what it points to is replaced.
    path = os.path.realpath(target)
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            with open(path, "wb") as device:
                yield device
            return
        mode = stat.S_IMODE(os.stat(path).st_mode) if os.path.exists(path) else 0o666 & ~_umask()
        folder, name = os.path.split(path)
        import tempfile  # costs 5 ms, which a pipe does not pay

        handle, temporary = tempfile.mkstemp(prefix=f".{name}.", dir=folder)
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(temporary, mode)
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
    except BrokenPipeError:
        raise
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{target}: {error.strerror or error}") from error


def check_folder(target: str) -> None:
    """Refuse a target whose folder is missing or read-only, before any work is done for it.

    Raises
    ------
    OutputError
    """
    path = os.path.realpath(target)
    if target == "-" or (os.path.exists(path) and not os.path.isfile(path)):
        return
    folder = os.path.dirname(path)
    if not os.path.isdir(folder):
        raise OutputError(f"{target}: {os.strerror(errno.ENOENT)}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{target}: {os.strerror(errno.EACCES)}")


def _discard_stdout() -> None:
    """Let what stdout still holds go nowhere: the interpreter flushes it once more at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
