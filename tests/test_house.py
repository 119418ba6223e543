"""House rules, looked up in the source: names, docstrings, sizes, imports without circles."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from thermaltool.cli import COMMANDS

HOUSE = Path(__file__).parents[1] / "thermaltool"
FILES = sorted(HOUSE.rglob("*.py"))
MAX_LINES, MAX_COMMAND_LINES = 400, 120

# Words for which the field has a term, and the names that keep one of them in its usual sense.
PRIVATE_WORDS = set(
    "brief losses rehearsal settling share sight standing told walk ways".split()  # noqa: SIM905
)
USUAL_SENSE = {
    "effective_share": "a fraction",
    "settling_time": "of a step response",
    "share": "a fraction",
    "walk": "a random walk",
}


def place(path: Path) -> str:
    """Path of a file below the package."""
    return path.relative_to(HOUSE).as_posix()


@cache
def source(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(source(path))


def lines(path: Path) -> int:
    return len(source(path).splitlines())


@cache
def classes(path: Path) -> tuple[ast.ClassDef, ...]:
    return tuple(node for node in ast.walk(tree_of(path)) if isinstance(node, ast.ClassDef))


def methods(node: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    """Public methods and properties of a class."""
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and not each.name.startswith("_"):
            yield each


def module_names(path: Path) -> Iterator[ast.ClassDef | ast.FunctionDef]:
    """Public classes and functions of a module."""
    for node in tree_of(path).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            yield node


def public_names(path: Path) -> Iterator[str]:
    """Names of a module's public classes and functions, and of the methods of these classes."""
    for node in module_names(path):
        yield node.name
        if isinstance(node, ast.ClassDef):
            yield from (method.name for method in methods(node))


def has_base(node: ast.ClassDef, *names: str) -> bool:
    """Whether a class is derived from one whose dotted name begins with one of these."""
    return any(ast.unparse(base).startswith(names) for base in node.bases)


def words(name: str) -> set[str]:
    """The words of a name in snake or camel case, in lower case."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


@pytest.mark.slow
def test_no_two_classes_have_one_name() -> None:
    places = defaultdict(list)
    for path in FILES:
        for node in classes(path):
            places[node.name].append(place(path))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


@pytest.mark.slow
def test_public_classes_and_functions_have_a_docstring() -> None:
    bare = {
        f"{place(path)}: {node.name}"
        for path in FILES
        for node in module_names(path)
        if ast.get_docstring(node) is None
    }
    assert bare == set()


def test_methods_have_a_docstring_where_no_base_class_has_it() -> None:
    """A method may also be described by the docstring of its class; a protocol's needs none."""
    documented = {
        method.name
        for path in FILES
        for node in classes(path)
        for method in methods(node)
        if ast.get_docstring(method) is not None
    }
    bare = [
        f"{place(path)}: {node.name}.{method.name}"
        for path in FILES
        for node in module_names(path)
        if isinstance(node, ast.ClassDef) and not has_base(node, "click", "Protocol")
        for method in methods(node)
        if ast.get_docstring(method) is None
        and method.name not in documented
        and not re.search(rf"\b{method.name}\b", ast.get_docstring(node) or "")
    ]
    assert bare == []


def test_files_are_short() -> None:
    assert {place(path) for path in FILES if lines(path) > MAX_LINES} == set()


def test_commands_are_short() -> None:
    commands = {
        place(path): lines(path)
        for path in (HOUSE / "cli").glob("*.py")
        if any(node.name == "command" for node in module_names(path))
    }
    assert len(commands) == len(COMMANDS)
    assert {name for name, n in commands.items() if n > MAX_COMMAND_LINES} == set()


def test_public_names_are_terms_of_the_field() -> None:
    private = {
        f"{place(path)}: {name}"
        for path in FILES
        for name in public_names(path)
        if words(name) & PRIVATE_WORDS and name not in USUAL_SENSE
    }
    assert private == set()


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("effective_share", {"effective", "share"}),
        ("SimulatedExperiments", {"simulated", "experiments"}),
        ("NCOffset", {"nc", "offset"}),
    ],
)
def test_names_fall_into_words(name: str, found: set[str]) -> None:
    assert words(name) == found


def module_of(path: Path) -> str:
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


def imported(tree: ast.Module) -> set[str]:
    """Modules that are imported with this one; not those of functions, which come later."""
    names = set()
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            waiting += node.orelse
            continue
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            # What is imported may be a module or a name in it.
            full = {f"{node.module}.{each.name}" for each in node.names}
            names |= {name if name in MODULES else node.module for name in full}
        waiting += ast.iter_child_nodes(node)
    return names & MODULES.keys()


def test_no_imports_go_in_a_circle() -> None:
    graph = {module: imported(tree_of(path)) for module, path in MODULES.items()}
    done: set[str] = set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        if module in way:
            pytest.fail(" -> ".join((*way[way.index(module) :], module)))
        if module not in done:
            for other in sorted(graph[module]):
                visit(other, (*way, module))
            done.add(module)

    for module in graph:
        visit(module, ())
