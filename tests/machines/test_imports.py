"""The machines share no code with the models that are judged on them."""

import ast
from pathlib import Path

import pytest

MODULES = sorted(p for p in Path(__file__).parent.rglob("*.py") if not p.name.startswith("test_"))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_a_machine_takes_nothing_but_plants_units_and_errors(path):
    allowed = ("thermaltool.plants", "thermaltool.units", "thermaltool.errors")
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
        own = [name for name in names if name.split(".")[0] == "thermaltool"]
        assert all(name.startswith(allowed) for name in own), own
