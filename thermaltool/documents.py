"""Documents and files at the border: JSON read field by field, files written whole or not at all.

A reader takes a value of a document and returns what a model holds, or raises `ModelError`; what
cannot be read is named with its place in the file.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, BinaryIO, Literal

from thermaltool.errors import ModelError, OutputError
from thermaltool.files import replaced_file
from thermaltool.parsing import first_fault, parse_json
from thermaltool.sources import read_input


@dataclass(frozen=True)
class DocumentFormat:
    """A JSON document of this tool: what its ``format`` and ``version`` say.

    Attributes
    ----------
    name : str
        The ``format`` field.
    version : int
        The newest version that is read, and the one that is written.
    noun : str
        What an error calls it.
    needs_version : bool
        Whether a document without ``version`` is refused; else it counts as the first.
    sealed : bool
        Whether it is written with a checksum of its content, ``sha256``.
    """

    name: str
    version: int
    noun: str
    needs_version: bool = True
    sealed: bool = False

    def wrap(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """The document of a body: ``format`` and ``version`` beside its fields."""
        document = {"format": self.name, "version": self.version, **body}
        return {**document, "sha256": content_digest(document)} if self.sealed else document

    def dumps(self, body: Mapping[str, Any], indent: int | None = 1) -> str:
        """The file's text: sorted keys.

        Raises
        ------
        ModelError
            NaN or infinity in the body.
        """
        return to_json(self.wrap(body), indent)

    def check_seal(self, document: Mapping[str, Any], source: str) -> str:
        """The digest of a document; ModelError where it has a checksum of another content."""
        digest = content_digest(document)
        if document.get("sha256", digest) != digest:
            raise ModelError(f"{source}: changed or damaged since it was written (its checksum)")
        return digest

    def loads(self, text: str, source: str) -> dict[str, Any]:
        """The document in a text.

        Raises
        ------
        ModelError
            No JSON, another format, no version or a newer one; each names `source`.
        """
        return self.check(parse_json(text, source, f" (not {self.noun})"), source)

    def check(self, document: Any, source: str) -> dict[str, Any]:
        """The document itself, if it is one of this format (ModelError as in `loads`)."""
        if not isinstance(document, dict) or "format" not in document:
            raise ModelError(f'{source}: not {self.noun} (no "format": "{self.name}")')
        if not self.matches(document):
            other = repr(document["format"])
            raise ModelError(f"{source}: not {self.noun}: format {other:.60} is not {self.name}")
        version = document.get("version", None if self.needs_version else 1)
        if type(version) is not int or version < 1:
            raise ModelError(f"{source}: no version of the format: {version!r}")
        if version > self.version:
            raise ModelError(
                f"{source}: version {version} is newer than this thermaltool reads "
                f"({self.version}): update it"
            )
        return document

    def matches(self, document: Mapping[str, Any]) -> bool:
        """Whether a document says that it is of this format, whatever its version."""
        return document.get("format") == self.name


# Numbers of logs and documents: fourth powers of them, which fits form, are still numbers.
MAX_NUMBER = 1e75

MODEL = DocumentFormat("thermaltool-model", 1, "a thermaltool model", sealed=True)
NOISE = DocumentFormat("thermaltool-noise", 1, "what thermaltool noise -o writes", False)
ARMA = DocumentFormat("thermaltool-arma", 1, "what thermaltool fit -o writes")
DIAGNOSIS = DocumentFormat("thermaltool-diagnosis", 1, "a diagnosis")
RC = DocumentFormat("thermaltool-rc", 1, "a network of thermaltool rc")
BODY = DocumentFormat("thermaltool-body", 1, "a body of thermaltool modes")
CONTROLLER = DocumentFormat(
    "thermaltool-controller", 1, "a controller of thermaltool design", sealed=True
)
CHECKPOINT = DocumentFormat("thermaltool-checkpoint", 2, "a checkpoint", sealed=True)
# What an error calls each by its name.
NOUNS = {
    each.name: each.noun
    for each in (MODEL, NOISE, ARMA, DIAGNOSIS, RC, BODY, CONTROLLER, CHECKPOINT)
}


def content_digest(document: Mapping[str, Any]) -> str:
    """Identifies what a document says, however it is laid out; its own checksum is left out."""
    content = {key: value for key, value in document.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def jsonable(value: Any) -> Any:
    """What JSON can say: lists for tuples and arrays, numbers of Python, None for NaN."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # NumPy, which a stream need not have loaded for this
        value = value.tolist()
    if isinstance(value, tuple | list):
        return [jsonable(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def to_json(document: Mapping[str, Any], indent: int | None = 1) -> str:
    """A document as text: sorted keys, an end of line; ModelError for NaN and infinity."""
    try:
        return json.dumps(document, sort_keys=True, indent=indent, allow_nan=False) + "\n"
    except ValueError as error:
        fault = first_fault(document) or str(error)
        raise ModelError(f"cannot be written: {fault}") from error


def write_json(document: Mapping[str, Any], target: str) -> None:
    """Write a document whole, as `to_json`; ``-`` is stdout."""
    write_whole(to_json(document).encode(), target)


def write_whole(data: bytes, target: str) -> None:
    """Write bytes as `atomic_output` does; ``-`` is stdout."""
    with atomic_output(target) as stream:
        stream.write(data)


def source_name(path: str) -> str:
    """What messages call an input; ``-`` is stdin."""
    return "<stdin>" if path == "-" else path


def read_text(path: str) -> tuple[str, str]:
    """The text of a file, or of stdin for ``-``, and what messages call it.

    Raises
    ------
    ModelError
        Not a text file.
    OSError
        It cannot be read.
    """
    try:
        return read_input(path).decode(), source_name(path)
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not a text file") from error


class Part:
    """An object of the file, which names the field that cannot be read."""

    def __init__(self, value: Any, place: str = "") -> None:
        self._value, self._place = value, place
        if not isinstance(value, dict):
            raise ModelError(f"{place}: not an object: {value!r:.60}")

    def read(self, field: str, reader: Callable[[Any], Any], *absent: Any) -> Any:
        """What `reader` makes of a field; `absent` where it is null or not there, if given."""
        value = self._value.get(field)
        if absent and value is None:
            return absent[0]
        if field not in self._value:
            raise ModelError(f"{self._place}{': ' if self._place else ''}{field!r} is missing")
        return read_at(reader, value, self._field(field))

    def parts(self, field: str, *absent: Any) -> list[Part]:
        """The objects of a list."""
        return [
            Part(each, f"{self._field(field)}[{k}]")
            for k, each in enumerate(self.read(field, items, *absent))
        ]

    def names(self) -> tuple[str, ...]:
        """The fields that are there."""
        return tuple(self._value)

    def part(self, field: str) -> Part:
        """The object in a field."""
        return Part(self.read(field, mapping), self._field(field))

    def as_whole(self, reader: Callable[[Any], Any]) -> Any:
        """What `reader` makes of the object."""
        return read_at(reader, self._value, self._place)

    def _field(self, field: str) -> str:
        return f"{self._place}.{field}" if self._place else field


def read_at(reader: Callable[[Any], Any], value: Any, place: str) -> Any:
    """What `reader` makes of a value, or where in the file it cannot."""
    try:
        return reader(value)
    except ModelError as error:
        raise ModelError(f"{place}: {error}") from error
    except KeyError as error:
        raise ModelError(f"{place}: {error.args[0]!r} is missing") from error
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{place}: cannot be read: {json.dumps(value):.60}") from error


def one_of(known: tuple[str, ...]) -> Callable[[Any], Any]:
    """A reader of one of several words."""

    def reader(value: Any) -> Any:
        if value not in known:
            raise ModelError(f"{value!r:.60} is none of {', '.join(known)}")
        return value

    return reader


def text(value: Any) -> str:
    """A name."""
    if not isinstance(value, str) or not value:
        raise ModelError(f"not a name: {value!r:.60}")
    return value


def items(value: Any) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise ModelError(f"not a list: {value!r:.60}")
    return value


def names(value: Any) -> tuple[str, ...]:
    """A list of names."""
    return tuple(map(text, items(value)))


def mapping(value: Any) -> dict[str, Any]:
    """An object."""
    if not isinstance(value, dict):
        raise ModelError(f"not an object: {value!r:.60}")
    return value


def bounded(value: Any) -> dict[str, Any]:
    """An object, all numbers of which are up to `MAX_NUMBER`."""
    if fault := first_fault(mapping(value), limit=MAX_NUMBER):
        raise ModelError(fault)
    return mapping(value)


def finite(value: Any) -> float:
    """A number up to `MAX_NUMBER`, neither NaN nor infinity."""
    number = isinstance(value, float | int) and not isinstance(value, bool)
    if not number or not abs(value) <= sys.float_info.max:
        raise ModelError(f"not a finite number: {value!r:.60}")
    if abs(value) > MAX_NUMBER:
        raise ModelError(f"too large, above {MAX_NUMBER:g}: {value:g}")
    return float(value)


def above_zero(value: Any) -> float:
    """A number above zero, the reciprocal of which is one of a document."""
    if not (number := finite(value)) > 0:
        raise ModelError(f"not above 0: {number:g}")
    if number < 1 / MAX_NUMBER:
        raise ModelError(f"too small, below {1 / MAX_NUMBER:g}: {number:g}")
    return number


def is_place(value: Any, count: int) -> bool:
    """Whether a value is the place of one of so many things, counted from 0."""
    return type(value) is int and 0 <= value < count


def rest(value: Any) -> float | Literal["first"]:
    """A number, or "first" for the first value of a log."""
    return "first" if value == "first" else finite(value)


def pair(values: Any) -> tuple[float, float]:
    """A low and a high number."""
    if not isinstance(values, list) or len(values) != 2:
        raise ModelError(f"not two numbers: {values!r:.60}")
    low, high = map(finite, values)
    if low > high:
        raise ModelError(f"{low:g} is above {high:g}")
    return low, high


def rising(values: Any) -> tuple[float, ...]:
    """Numbers from 0 on, none below the one before."""
    numbers = tuple(map(finite, items(values)))
    if any(b < a for a, b in zip((0.0, *numbers), numbers, strict=False)):
        raise ModelError("not numbers that rise from 0")
    return numbers


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
        with replaced_file(path) as stream:
            yield stream
    except BrokenPipeError:
        raise
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{target}: {error.strerror or error}") from error


def check_folder(target: str) -> None:
    """Refuse a folder, or a target whose folder is missing or read-only, before any work is done.

    Raises
    ------
    OutputError
    """
    path = os.path.realpath(target)
    if target != "-" and os.path.isdir(path):
        raise OutputError(f"{target}: {os.strerror(errno.EISDIR)}")
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
