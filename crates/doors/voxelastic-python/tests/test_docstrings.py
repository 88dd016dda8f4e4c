"""Everything public says what it is: shapes of arrays, units of numbers, frames of poses, errors."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import voxelastic as vx

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "voxelastic"

SHAPE = re.compile(r"\b(N|M|V|T|E|[Rr]ows|columns|numbers|values|x 3|x 4|3 x 3|4 x 4|x, y, z)\b|where the robot|where it should go", re.I)
UNIT = re.compile(
    r"\b(metres|seconds|degrees|radians|pixels|bytes|share|number|factor|0 to 1|range|voxels?|m per|rate|quality|weight|time|distance|radius|step)\b", re.I
)
FRAME = re.compile(r"\b(frame|pose in|poses of the lidar|true poses|4 x 4 poses|the same by)\b", re.I)
# Poses of trajectories are compared in whatever frame they have.
ANY_FRAME = {"trajectory_errors.estimate", "trajectory_errors.truth"}

Function = ast.FunctionDef


def public_items() -> Iterator[tuple[str, ast.ClassDef | Function]]:
    for path in sorted(PACKAGE.glob("_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.ClassDef, Function)) and node.name in vx.__all__:
                yield node.name, node


def functions() -> Iterator[tuple[str, Function, str]]:
    """All public functions and methods with their names and the text that documents their arguments."""
    for name, node in public_items():
        if isinstance(node, Function):
            yield name, node, ast.get_docstring(node) or ""
            continue
        for item in (item for item in node.body if isinstance(item, Function)):
            if item.name == "__init__":
                yield name, item, ast.get_docstring(node) or ""
            elif not item.name.startswith("_"):
                yield f"{name}.{item.name}", item, ast.get_docstring(item) or ""


def is_property(function: Function) -> bool:
    return any(isinstance(decorator, ast.Name) and decorator.id == "property" for decorator in function.decorator_list)


def arguments(function: Function) -> list[ast.arg]:
    listed = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [argument for argument in listed if argument.arg not in ("self", "cls")]


def entry(doc: str, argument: str) -> str:
    """What the section of arguments says about one of them."""
    found = re.search(rf"^ *{argument}: (.*(?:\n {{5,}}.*)*)", doc, re.M)
    return found[1] if found else ""


def test_all_of_it_has_docstrings() -> None:
    found = dict(public_items())
    aliases = {"Event", "Points", "Pose", "Progress", "Surface", "__version__"}
    assert set(vx.__all__) - aliases == set(found), "classes and functions are defined in files of the package"
    missing = [name for name, node in found.items() if not ast.get_docstring(node)]
    missing += [name for name, _, doc in functions() if not doc]
    for name, node in found.items():
        body = node.body if isinstance(node, ast.ClassDef) else []
        for item, after in zip_longest(body, body[1:]):
            is_documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)
            # A class that is a value documents what it holds.
            if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and not item.target.id.startswith("_") and not is_documented:
                missing.append(f"{name}.{item.target.id}")
    # Settings as keyword arguments are documented in `Settings`.
    assert [name for name in missing if not name.startswith("SettingArguments.")] == []


def test_arguments_are_documented_with_shapes_units_and_frames() -> None:
    problems = []
    for name, function, doc in functions():
        for argument in arguments(function):
            said, type_ = entry(doc, argument.arg), ast.unparse(argument.annotation) if argument.annotation else ""
            if not said and f"`{argument.arg}`" not in doc and not (argument.arg == "points" and "N x 3 points" in doc) and len(arguments(function)) > 1:
                problems.append(f"{name}: nothing about {argument.arg}")
                continue
            text = said or doc
            if re.search("ArrayLike|Points", type_) and not SHAPE.search(text):
                problems.append(f"{name}: no shape of {argument.arg}")
            if re.search(r"\b(float|int)\b", type_) and not re.search(r"^(Mapping|Sequence|tuple)", type_) and not UNIT.search(text):
                problems.append(f"{name}: no unit of {argument.arg}: {text}")
            if "Pose" in type_ and not FRAME.search(text) and f"{name}.{argument.arg}" not in ANY_FRAME:
                problems.append(f"{name}: no frame of {argument.arg}")
    assert problems == []


def test_arrays_that_are_given_have_shapes_and_units() -> None:
    problems = []
    documented = [(name, ast.unparse(function.returns) if function.returns else "", doc) for name, function, doc in functions() if function.name != "__init__"]
    for name, node in public_items():
        body = node.body if isinstance(node, ast.ClassDef) else []
        for item, after in zip(body, body[1:], strict=False):
            if isinstance(item, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                documented.append((f"{name}.{ast.unparse(item.target)}", ast.unparse(item.annotation), str(after.value.value)))
    for name, type_, doc in documented:
        if "NDArray" in type_ and not SHAPE.search(doc):
            problems.append(f"{name}: no shape")
        if re.search(r"NDArray\[np\.float|^float", type_) and not re.search(r"metres|seconds|unit|normals|weights|4 x 4|strengths|share|6 x 6|radians|0 to 1|Allowed", doc, re.I):
            problems.append(f"{name}: no unit")
    assert len(documented) > 60 and problems == []


def test_errors_are_documented() -> None:
    """What a function raises itself is in its docstring, or in that of its class."""
    classes = {name: ast.get_docstring(node) or "" for name, node in public_items()}
    problems = []
    for name, function, doc in functions():
        raised = {ast.unparse(node.exc.func) for node in ast.walk(function) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)}
        text = doc + classes.get(name.partition(".")[0], "")
        # A wrong type is a mistake in the program; types are in the signature.
        problems += [f"{name}: {error}" for error in sorted(raised - {"TypeError"}) if not re.search(rf"\b{error}\b", text)]
    assert problems == []


def test_the_native_part_is_documented_too() -> None:
    tree = ast.parse((PACKAGE / "_native.pyi").read_text(encoding="utf-8"))
    items = [node for node in ast.walk(tree) if isinstance(node, (ast.ClassDef, Function)) and node.name != "__new__"]
    assert len(items) > 40 and [node.name for node in items if not ast.get_docstring(node)] == []
