"""The committed type stub of the C++ module has the module's names, members and arguments."""

import ast
import inspect
import re
from pathlib import Path

import gsut
from gsut import _core

STUB = Path(gsut.__file__).with_name("_core.pyi")
# Special methods that a class of the module defines for its users; __init__ is compared too.
SPECIAL = ("__eq__",)


def is_public(name: str) -> bool:
    return not name.startswith("_") or name in ("__version__", "__init__", *SPECIAL)


def stub_members(body: list[ast.stmt]) -> dict[str, ast.stmt]:
    """Public names that a module or class body of the stub defines."""
    members: dict[str, ast.stmt] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            members[node.name] = node
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            members[node.target.id] = node
    return {name: node for name, node in members.items() if is_public(name)}


def stub_arguments(function: ast.FunctionDef) -> list[tuple[str, bool]]:
    """Names of the arguments, self left out, each with whether it has a default."""
    args = function.args
    names = [argument.arg for argument in args.args + args.kwonlyargs]
    required = len(args.args) - len(args.defaults)
    optional = [False] * required + [True] * len(args.defaults)
    optional += [default is not None for default in args.kw_defaults]
    return [pair for pair in zip(names, optional, strict=True) if pair[0] != "self"]


def bound_arguments(name: str, function) -> list[tuple[str, bool]]:
    """The same of a function of the module, from the signature that pybind11 writes as its doc."""
    line = (function.__doc__ or "").splitlines()[0]
    match = re.fullmatch(rf"{re.escape(name)}\((.*)\) -> .+", line)
    assert match, f"{name}: the first line of its doc is no signature: {line!r}"
    # Valid Python but for defaults shown by repr: parse them as text.
    tree = ast.parse(f"def f({re.sub(r'<[^>]*>', '...', match.group(1))}): ...").body[0]
    assert isinstance(tree, ast.FunctionDef)
    return stub_arguments(tree)


def module_members(owner) -> dict[str, object]:
    return {name: value for name, value in vars(owner).items() if is_public(name)}


def stub_classes() -> dict[str, ast.ClassDef]:
    members = stub_members(ast.parse(STUB.read_text()).body)
    return {name: node for name, node in members.items() if isinstance(node, ast.ClassDef)}


def own_init(bound: type) -> bool:
    """Whether the class can be made in Python (pybind11 gives the others a shared __init__)."""
    return "__init__" in vars(bound) and "wrapper" not in type(vars(bound)["__init__"]).__name__


def test_stub_names_are_those_of_the_module():
    stub = stub_members(ast.parse(STUB.read_text()).body)
    assert len(stub) > 30
    assert sorted(stub) == sorted(module_members(_core))


def test_stub_functions_have_the_arguments_of_the_module():
    stub = stub_members(ast.parse(STUB.read_text()).body)
    compared = 0
    for name, node in stub.items():
        if isinstance(node, ast.FunctionDef):
            assert stub_arguments(node) == bound_arguments(name, getattr(_core, name)), name
            compared += 1
    assert compared == sum(inspect.isbuiltin(value) for value in module_members(_core).values())


def test_stub_classes_have_the_members_of_the_module():
    compared = 0
    for class_name, node in stub_classes().items():
        bound = getattr(_core, class_name)
        stub = stub_members(node.body)
        members = module_members(bound)
        if not own_init(bound):
            members.pop("__init__", None)
        assert sorted(stub) == sorted(members), class_name
        for name, member in stub.items():
            where = f"{class_name}.{name}"
            value = members[name]
            if isinstance(member, ast.AnnAssign):
                assert isinstance(value, property) and value.fset, f"{where} is not writable"
            elif any(ast.unparse(mark) == "property" for mark in member.decorator_list):
                assert isinstance(value, property) and not value.fset, f"{where} is writable"
            elif name not in SPECIAL:
                assert stub_arguments(member) == bound_arguments(name, value), where
            compared += 1
    assert compared > 40


def test_stub_classes_have_the_bases_of_the_module():
    classes = stub_classes()
    assert len(classes) >= 7
    for name, node in classes.items():
        bases = [base.__name__ for base in getattr(_core, name).__bases__]
        expected = [ast.unparse(base) for base in node.bases] or ["pybind11_object"]
        assert bases == expected, name
