"""JSON and TOML whose every number and name can be worked with, and where one cannot."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from datetime import datetime
from typing import Any

from thermaltool.errors import ModelError

# Lists and objects inside each other; a model has about six.
MAX_DEPTH = 50
# Python neither reads nor prints longer integers.
MAX_DIGITS = 4300
TOO_DEEP = f"nested deeper than {MAX_DEPTH}"


def parse_json(text: str, source: str, purpose: str = "") -> Any:
    """The value of a JSON text, every number and name of which can be worked with.

    Parameters
    ----------
    text : str
    source : str
        What messages call it.
    purpose : str
        What follows a message that it is no JSON.

    Raises
    ------
    ModelError
        No JSON; NaN, infinity or an integer beyond every float; lists in lists beyond `MAX_DEPTH`;
        half a surrogate pair. Each names the source and the place.
    """
    try:
        document = json.loads(text, parse_int=_integer, object_pairs_hook=unique_keys)
    except json.JSONDecodeError as error:
        raise ModelError(f"{source}:{error.lineno}: not JSON: {error.msg}{purpose}") from error
    except RecursionError as error:
        raise ModelError(f"{source}: {TOO_DEEP}{purpose}") from error
    except KeyTwiceError as error:
        raise ModelError(f"{source}: {error}") from error
    if fault := first_fault(document):
        raise ModelError(f"{source}: {fault}")
    return document


def parse_toml(data: bytes, source: str) -> dict[str, Any]:
    """The table of a TOML text; raises as `parse_json`.

    Parameters
    ----------
    data : bytes
    source : str
        What messages call it.
    """
    import tomllib

    try:
        table = tomllib.loads(data.decode("utf-8-sig"))
    except RecursionError as error:
        raise ModelError(f"{source}: {TOO_DEEP}") from error
    except ValueError as error:  # of TOML, of UTF-8, or an integer of some thousand digits
        raise ModelError(f"{source}: not TOML: {error}") from error
    if fault := first_fault(table):
        raise ModelError(f"{source}: {fault}")
    return table


class KeyTwiceError(ValueError):
    """An object of JSON in which two values have one key."""


def unique_keys(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON by its keys.

    Parameters
    ----------
    pairs : iterable of (key, value)

    Raises
    ------
    KeyTwiceError
        One key has two values, of which any may be meant.
    """
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise KeyTwiceError(f"the key {key!a:.60} is there twice")
        found[key] = value
    return found


def numbers_among(words: Iterable[str]) -> list[float]:
    """The words that are numbers, as such.

    Parameters
    ----------
    words : iterable of str
    """
    numbers = []
    for word in words:
        with suppress(ValueError):
            numbers.append(float(word))
    return numbers


def is_time_pattern(text: str) -> bool:
    """Whether stamps can be read by a pattern.

    Parameters
    ----------
    text : str
        As `datetime.strptime` takes it.
    """
    try:
        datetime.strptime("", text)
    except re.error:
        return False
    except ValueError as error:  # of a good one, that it is not matched
        return "does not match" in str(error)
    return not text


def _integer(digits: str) -> float:
    return int(digits) if len(digits) < MAX_DIGITS else float(digits)


def first_fault(
    value: Any, place: str = "", depth: int = 0, limit: float = sys.float_info.max
) -> str | None:
    """Where a document holds what no reader and no writer can take; None where it does not.

    Parameters
    ----------
    value : object
        Of dicts, lists, texts and numbers.
    place : str
        Of the value in the document.
    depth : int
        Lists and objects around it.
    limit : float
        The largest number.
    """
    if isinstance(value, dict | list):
        if depth == MAX_DEPTH:
            return f"{place:.60}: {TOO_DEEP}"
        parts = value.items() if isinstance(value, dict) else enumerate(value)
        for key, part in parts:
            # Most are numbers in order: their place costs more than their check.
            if type(part) is float and abs(part) <= limit:
                continue
            inside = f"{place}[{key}]" if isinstance(value, list) else f"{place}.{key}".lstrip(".")
            if fault := first_fault(part, inside, depth + 1, limit):
                return fault
        texts = [key for key in value if isinstance(key, str)] if isinstance(value, dict) else []
    else:
        texts = [value] if isinstance(value, str) else []
        if isinstance(value, float | int) and not abs(value) <= limit:
            finite = abs(value) <= sys.float_info.max
            what = f"too large, above {limit:g}" if finite else "not a finite number"
            return f"{place}: {what}: {value!r:.60}"
    for each in texts:
        try:
            each.encode()
        except UnicodeEncodeError:
            return f"{place!a}: not a text: {each!a:.60}"
    return None
