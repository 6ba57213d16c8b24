"""What tests replace in the product must be there: a hook that has lost its name asserts nothing (< 1 s)."""

import ast
from pathlib import Path

TESTS = Path(__file__).resolve().parent
FILES = sorted(TESTS.rglob("*.py"))


def assigned_attributes(tree):
    """Each `thing.attribute = value` but for those of `self`, with the value."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            if isinstance(target, ast.Attribute) and not (
                isinstance(target.value, ast.Name) and target.value.id == "self"
            ):
                yield target, node.value


def unchecked_patches(source):
    """What replaces a function or something private without asking whether it is there."""
    tree = ast.parse(source)
    calls = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("setattr")
    ]
    return [
        ast.unparse(target)
        for target, value in assigned_attributes(tree)
        if isinstance(value, ast.Lambda) or target.attr.startswith("_")
    ] + [ast.unparse(call) for call in calls if any(keyword.arg == "raising" for keyword in call.keywords)]


def test_functions_and_private_names_are_replaced_by_monkeypatch_which_refuses_those_that_are_not_there():
    found = {path.relative_to(TESTS).as_posix(): unchecked_patches(path.read_text(encoding="utf-8")) for path in FILES}
    assert len(found) > 100
    assert {name: patches for name, patches in found.items() if patches} == {}


def test_a_hook_that_nobody_calls_is_found():
    found = unchecked_patches("vector._started = 1\ncore.f = lambda: 3\nself._x = 1\na.b = 2\np.setattr(c, 'd', 4)")
    assert found == ["vector._started", "core.f"]
    assert unchecked_patches("patch.setattr(core, 'gone', 1, raising=False)") != []
