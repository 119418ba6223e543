"""Whatever a file holds: one line, an exit code, and an end."""

from __future__ import annotations

import os

import pytest
from faults.mutations import spoil

# Of these some ten failed before numbers and depths were checked where documents are read.
COUNT = 300


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_spoiled_file_is_answered_in_one_line(tmp_path) -> None:
    seed = int(os.environ.get("THERMALTOOL_FAULT_SEED") or int.from_bytes(os.urandom(4), "big"))
    found = []

    def report(number, case, data, fault, seconds):
        words = " ".join(case.arguments).replace(f"{tmp_path}/", "")
        found.append(f"number {number}: {words} of a spoiled {case.file.name}: {fault}")

    spoil(tmp_path, COUNT, seed, report)
    assert not found, "\n".join([f"THERMALTOOL_FAULT_SEED={seed}", *found])
