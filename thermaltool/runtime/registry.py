"""Tables of what can be chosen by name: each entry is ``module:class``, loaded when it is used."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any


def load(table: Mapping[str, str], name: str, refusal: str) -> Any:
    """The class that `table` has under `name`.

    Raises
    ------
    ValueError
        There is none: the `refusal`, and what there is.
    """
    if name not in table:
        raise ValueError(f"{refusal} {name}: there are {', '.join(table)}")
    module, _, attribute = table[name].partition(":")
    return getattr(importlib.import_module(module), attribute)
