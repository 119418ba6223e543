"""Files that appear whole, and names of files that hold a word of the user's data."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import time
import unicodedata
from collections.abc import Iterator, Sequence
from typing import BinaryIO

# What a temporary file is called: hidden, the target's name, and a mark by which a later run knows
# what a killed one has left.
MARK = ".thermaltool-part"
# Younger ones may belong to a run that is only slow to lock its own [s].
STALE_AFTER = 60.0
# Bytes of a file's name; 255 in the usual file systems.
MAX_NAME = 255
# Bytes that a word of the user's data may take of it.
MAX_WORD = 100


@contextlib.contextmanager
def replaced_file(path: str) -> Iterator[BinaryIO]:
    """A file beside `path` for bytes; it takes the place of `path` when the block ends well.

    It is locked while it is open: what a killed process left is not, and is taken away by the next
    that writes the same file.

    Raises
    ------
    OSError
        It cannot be written. What was there before still is.
    """
    mode = stat.S_IMODE(os.stat(path).st_mode) if os.path.exists(path) else 0o666 & ~_umask()
    folder, name = os.path.split(path)
    _remove_stale(folder, name)
    import tempfile  # costs 5 ms, which a pipe does not pay

    handle, temporary = tempfile.mkstemp(prefix=_prefix(name), suffix=MARK, dir=folder)
    try:
        with os.fdopen(handle, "wb") as stream:
            _lock(handle)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            os.chmod(temporary, mode)
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    _sync_folder(folder)


def _prefix(name: str) -> str:
    # A name may be as long as the file system allows, and a temporary one adds to it.
    room = MAX_NAME - len(MARK) - 20
    return f".{name.encode()[:room].decode(errors='ignore')}."


def _remove_stale(folder: str, name: str) -> None:
    """Take away what killed runs have left beside a file."""
    pattern = re.compile(re.escape(_prefix(name)) + r"[a-z0-9_]{8}" + re.escape(MARK))
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if pattern.fullmatch(entry.name) and _is_stale(entry):
                os.unlink(entry.path)


def _is_stale(entry: os.DirEntry[str]) -> bool:
    """Whether a temporary file is old and no process holds it."""
    if entry.is_symlink() or time.time() - entry.stat().st_mtime < STALE_AFTER:
        return False
    handle = os.open(entry.path, os.O_RDONLY)
    try:
        return _lock(handle)
    finally:
        os.close(handle)


def _lock(handle: int) -> bool:
    """Whether a file could be locked; where the system or the file system knows no locks, not."""
    try:
        import fcntl
    except ImportError:  # Windows
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _sync_folder(folder: str) -> None:
    """Make a new name last through a power cut; not every system or file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder or ".", os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def file_words(names: Sequence[str]) -> list[str]:
    """A part of a file's name for each of several names of channels, logs or causes.

    Parameters
    ----------
    names : sequence of str
        Any text; equal ones get words of their own.

    Returns
    -------
    list of str
        Letters, digits, ``_``, ``-``, ``+`` and inner points: no folder, no hidden file. No two
        are the same, even where a file system does not tell capitals.
    """
    words: list[str] = []
    taken: set[str] = set()
    for name in names:
        plain = re.sub(r"[^\w+.-]", "-", unicodedata.normalize("NFKC", name)).strip(".")
        word = base = plain.encode()[:MAX_WORD].decode(errors="ignore") or "-"
        count = 1
        while word.casefold() in taken:
            count += 1
            word = f"{base}_{count}"
        taken.add(word.casefold())
        words.append(word)
    return words


def file_names(paths: Sequence[str]) -> list[str]:
    """Files as messages and figures call them side by side: without folders where that is enough.

    Parameters
    ----------
    paths : sequence of str

    Returns
    -------
    list of str
        No two are the same: a file that comes again is counted.
    """
    short = [os.path.basename(path) for path in paths]
    names = short if len(set(short)) == len(short) else paths
    counts: dict[str, int] = {}
    found = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        found.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return found
