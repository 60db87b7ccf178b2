"""No call gives one thing where another of its names is asked for."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("pipeline", "service", "catalog_tools")
MEANT = {
    ("pipeline.commands.worker", "port"),  # of the nanny: dask's name for it
    ("pipeline.physics.noise.wells", "measured_e"),  # the other way round: its inverse
    ("pipeline.sweep.points", "concerns"),  # the same either way
}
Function = ast.FunctionDef | ast.AsyncFunctionDef


def modules() -> dict[str, ast.Module]:
    paths = [p for package in PACKAGES for p in (ROOT / package).rglob("*.py")]
    return {".".join(p.relative_to(ROOT).with_suffix("").parts): ast.parse(p.read_text())
            for p in paths}  # fmt: skip


def crossed_by_keyword(tree: ast.Module) -> Iterator[str]:
    """Of calls like f(a=b) where the caller has an `a` and a `b` of its own."""
    for function in ast.walk(tree):
        if not isinstance(function, Function):
            continue
        own = {a.arg for a in (*function.args.args, *function.args.kwonlyargs)}
        for call in ast.walk(function):
            for k in call.keywords if isinstance(call, ast.Call) else ():
                given = k.value.id if isinstance(k.value, ast.Name) else None
                if k.arg in own and given in own and given != k.arg:
                    yield str(k.arg)


def crossed_in_order(tree: ast.Module, known: dict[str, list[str]]) -> Iterator[str]:
    """Of calls like f(b, a) of a function f(a, b)."""
    for call in ast.walk(tree):
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name)):
            continue
        names = known.get(call.func.id, [])
        given = [a.id if isinstance(a, ast.Name) else a.attr if isinstance(a, ast.Attribute)
                 else None for a in call.args]  # fmt: skip
        pairs = [(asked, name) for asked, name in zip(names, given, strict=False)
                 if name in names and name != asked]  # fmt: skip
        if any((b, a) in pairs for a, b in pairs):
            yield call.func.id


def asked_of(tree: ast.Module) -> dict[str, list[str]]:
    """The parameters of a module's functions, in order."""
    return {f.name: [a.arg for a in f.args.args] for f in tree.body if isinstance(f, Function)}


def test_names_are_not_crossed() -> None:
    trees = modules()
    defined = {name: asked_of(tree) for name, tree in trees.items()}
    found = set()
    for name, tree in trees.items():
        known = dict(defined[name])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in defined:
                known |= {a.asname or a.name: defined[node.module][a.name] for a in node.names
                          if a.name in defined[node.module]}  # fmt: skip
        found |= {(name, one) for one in crossed_by_keyword(tree)}
        found |= {(name, one) for one in crossed_in_order(tree, known)}
    assert found == MEANT


def test_crossed_names_are_seen() -> None:
    tree = ast.parse("def f(a, b):\n    return g(a=b)\ndef g(a, b):\n    return f(b, a)")
    assert list(crossed_by_keyword(tree)) == ["a"]
    assert list(crossed_in_order(tree, asked_of(tree))) == ["f"]
    straight = ast.parse("def f(a, b):\n    return g(a=a)\ndef g(a, b):\n    return f(a, b)")
    assert not [*crossed_by_keyword(straight), *crossed_in_order(straight, asked_of(straight))]
