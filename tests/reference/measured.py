"""Where the tests find data that this project did not make."""

from __future__ import annotations

from pathlib import Path

import pytest

PUBLISHED = Path(__file__).parent / "published"
SHARED = Path(__file__).parents[3] / "shared" / "data"
MAPS = Path(__file__).parents[2] / "data_samples" / "maps"


def published(name: str) -> Path:
    """A series or an excerpt that every checkout has; sources and licences in its README."""
    return PUBLISHED / name


def whole_log(name: str) -> Path:
    """A whole measured log of ../shared/data; the test is skipped where it is not there."""
    if not (SHARED / name).exists():
        pytest.skip(f"../shared/data/{name} is not here: whole logs are not copied (licences)")
    return SHARED / name
