"""Every public function and method says what it takes and gives."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"astrojax": "astrojax/src", "owm_envs": "outofthisworldmodel-envs/src", "owm": "outofthisworldmodel/src"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(body: list[ast.stmt], inside: str = "") -> Iterator[tuple[str, Function, bool]]:
    """Public functions of a module, and public methods, `__init__` and `__call__` of its classes, private ones too."""
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from public(node.body, f"{inside}{node.name}.")
        elif isinstance(node, Function) and (not node.name.startswith("_") or node.name in ("__init__", "__call__")):
            yield inside + node.name, node, bool(inside)


def missing(name: str, node: Function, method: bool) -> list[str]:
    """What of a function is not annotated; the first parameter of a method needs nothing, nor does what it draws up."""
    every = node.args.posonlyargs + node.args.args
    static = any(isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list)
    every = every[method and not static :] + node.args.kwonlyargs
    every += [arg for arg in (node.args.vararg, node.args.kwarg) if arg]
    lacking = [arg.arg for arg in every if arg.annotation is None]
    return lacking + ["return"] * (node.returns is None and node.name != "__init__")


def test_what_is_missing_is_found():
    source = "class A:\n def f(self, a, *, b: int): ...\n @staticmethod\n def g(c, *d) -> int: ...\ndef _h(e): ..."
    found = {name: missing(name, node, method) for name, node, method in public(ast.parse(source).body)}
    assert found == {"A.f": ["a", "return"], "A.g": ["c", "d"]}


@pytest.mark.parametrize("package", SOURCES)
def test_public_functions_are_annotated(package):
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno} {name}: {', '.join(lacking)}"
        for file in sorted((ROOT / SOURCES[package] / package).rglob("*.py"))
        for name, node, method in public(ast.parse(file.read_text(encoding="utf-8")).body)
        if (lacking := missing(name, node, method))
    ]
    assert not found, "\n".join(found)
