"""Declarations that users write in TOML: named tables, and fields that nobody reads."""

from __future__ import annotations

import re
from collections.abc import Iterator

from thermaltool.documents import Part
from thermaltool.errors import ModelError
from thermaltool.record import hint

# What follows another word in messages and parameters' names.
_NAME = re.compile(r"[A-Za-z0-9_-]+")


def named_tables(whole: Part, field: str) -> Iterator[tuple[str, Part]]:
    """The named tables of a section, which may be absent."""
    if field not in whole.names():
        return
    section = whole.part(field)
    for name in section.names():
        if not _NAME.fullmatch(name):
            raise ModelError(f"{field}: a name has letters, digits, _ and -, not {name!r:.60}")
        yield name, section.part(name)


def known_fields(part: Part, place: str, *fields: str) -> None:
    """Refuse fields that nobody reads."""
    for name in part.names():
        if name not in fields:
            before = f"{place}: " if place else ""
            raise ModelError(f"{before}no field {name!r:.60} is known{hint(name, fields)}")
