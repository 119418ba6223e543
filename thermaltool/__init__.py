"""Thermal error of machines: from a measured log to a compensated stream.

The functions of `thermaltool.api`, and the types that they take and return, are loaded when they
are first asked for::

    import thermaltool as tt
"""

from __future__ import annotations

import importlib

# As of `typing`, which alone would cost more than this module.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from thermaltool.api import *  # noqa: F403

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    api = importlib.import_module("thermaltool.api")
    if name not in api.__all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(api, name)


def __dir__() -> list[str]:
    return [*globals(), *importlib.import_module("thermaltool.api").__all__]
