#!/usr/bin/env python3
"""Writes docs/src/python/reference.md from the docstrings and types in python/voxelastic.

    python crates/doors/voxelastic-python/generate_reference.py            write it
    python crates/doors/voxelastic-python/generate_reference.py --check    fail if it is out of date
"""

import ast
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
PACKAGE = HERE / "python" / "voxelastic"
TARGET = HERE.parents[2] / "docs" / "src" / "python" / "reference.md"

HEAD = """# Python reference

The classes and functions of the package `voxelastic`, in the order in which one meets them. [For Python users](index.md) shows how they are used. Written by `generate_reference.py` from the docstrings: do not edit.
"""

ORDER = [
    *("Mapper", "ScanReport", "Map", "Mesh", "Query", "State", "RayHits", "Slice", "Path", "Submap", "SubmapChanges", "Merged", "Blocks", "Dataset", "Scan", "Edge", "PoseUpdate"),
    *("Odometry", "OdometryReport", "Trajectory", "Localiser", "Location", "Simulation", "TrajectoryErrors", "Settings"),
]
FUNCTIONS = ["odometry", "evaluate", "trajectory_errors", "limit_memory"]
ERRORS = ["Error", "SettingError", "RefusedError", "FileError", "PlanError", "RunWarning"]
# Modules that are imported by themselves, and what is in them; of a class that others call, its own words are enough.
PARTS = {"notebook": ["MapView"], "rerun": ["log", "Logger"], "evalio": ["Voxelastic"]}
ALIASES = ["Points", "Pose", "Event", "Surface", "Progress"]


def definitions() -> tuple[dict[str, ast.ClassDef], dict[str, ast.FunctionDef], dict[str, tuple[str, str]]]:
    """All classes and functions, and all aliases of types with their documentation."""
    classes: dict[str, ast.ClassDef] = {}
    functions: dict[str, ast.FunctionDef] = {}
    aliases: dict[str, tuple[str, str]] = {}
    for path in sorted(PACKAGE.glob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        classes |= {node.name: node for node in body if isinstance(node, ast.ClassDef)}
        functions |= {node.name: node for node in body if isinstance(node, ast.FunctionDef)}
        for node, name, value, doc in documented(body):
            if isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation) == "TypeAlias":
                aliases[name] = (value, doc)
    return classes, functions, aliases


def documented(body: list[ast.stmt]) -> list[tuple[ast.stmt, str, str, str]]:
    """Assignments that are followed by a docstring: the statement, the name, its type or value, the docstring."""
    found: list[tuple[ast.stmt, str, str, str]] = []
    for node, after in zip(body, body[1:], strict=False):
        if not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)):
            continue
        doc = " ".join(after.value.value.split())
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            is_alias = ast.unparse(node.annotation) == "TypeAlias"
            shown = ast.unparse(node.value) if is_alias and node.value else ast.unparse(node.annotation)
            found.append((node, node.target.id, shown, doc))
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found.append((node, node.targets[0].id, ast.unparse(node.value), doc))
    return found


def prose(doc: str) -> str:
    """A docstring as Markdown: its sections become lists."""
    lines, section = [], ""
    for line in doc.split("\n"):
        if heading := re.fullmatch(r"(Args|Raises|Returns):", line.strip()):
            section = heading[1]
            lines += [f"{ {'Args': 'Arguments', 'Raises': 'Exceptions', 'Returns': 'Returns'}[section] }:", ""]
        elif section and line.strip() and not line.startswith(" "):
            section = ""
            lines += ["", line]
        elif section in ("Args", "Raises") and (item := re.fullmatch(r"    (\w+): (.*)", line)):
            lines.append(f"- `{item[1]}`: {item[2]}")
        elif section and line.strip():
            lines.append(f"  {line.strip()}" if section != "Returns" else line.strip())
        else:
            lines.append(line)
    return "\n".join(lines).strip()


def signature(function: ast.FunctionDef, owner: str) -> str:
    """The call as it is written, one line."""
    arguments = function.args
    first = [*arguments.posonlyargs, *arguments.args]
    if first and first[0].arg in ("self", "cls"):
        del arguments.args[0]
    kinds = {decorator.id for decorator in function.decorator_list if isinstance(decorator, ast.Name)}
    name = owner if function.name == "__init__" else f"{owner}.{function.name}" if kinds & {"classmethod", "staticmethod"} else function.name
    returns = f" -> {ast.unparse(function.returns)}" if function.returns and function.name != "__init__" else ""
    return f"{name}({ast.unparse(arguments)}){returns}"


def section(node: ast.ClassDef) -> str:
    """A class: its documentation, attributes and methods."""
    parts = [f"## {node.name}", prose(ast.get_docstring(node) or "")]
    attributes = [f"- `{name}`: `{shown}`. {doc}" for _, name, shown, doc in documented(node.body) if not name.startswith("_")]
    methods = []
    for function in (item for item in node.body if isinstance(item, ast.FunctionDef)):
        doc = ast.get_docstring(function)
        is_property = any(isinstance(d, ast.Name) and d.id == "property" for d in function.decorator_list)
        if function.name == "__init__" and (function.args.args[1:] or function.args.kwonlyargs):
            parts.insert(1, f"```python\n{signature(function, node.name)}\n```")
        elif doc is None or function.name.startswith("_"):
            continue
        elif is_property:
            attributes.append(f"- `{function.name}`: `{ast.unparse(function.returns) if function.returns else ''}`. {' '.join(doc.split())}")
        else:
            methods.append(f"### {node.name}.{function.name}\n\n```python\n{signature(function, node.name)}\n```\n\n{prose(doc)}")
    return "\n\n".join([*parts, *(["Attributes:\n\n" + "\n".join(attributes)] if attributes else []), *methods])


def function_section(node: ast.FunctionDef) -> str:
    """A function: how it is called, its documentation."""
    return f"## {node.name}\n\n```python\n{signature(node, '')}\n```\n\n{prose(ast.get_docstring(node) or '')}"


def part_sections(part: str, names: list[str]) -> list[str]:
    """A module that is imported by itself."""
    tree = ast.parse((PACKAGE / f"{part}.py").read_text(encoding="utf-8"))
    summary, _, example = (ast.get_docstring(tree) or "").partition("\n\n")
    code = [line[4:] for line in example.split("\n") if line.startswith("    ") or not line]
    remarks = [line for line in example.split("\n") if line and not line.startswith("    ")]
    language = "sh" if part == "evalio" else "python"
    block = "\n".join(code).strip()
    found = [f"## voxelastic.{part}", summary.strip(), f"```{language}\n{block}\n```", *remarks]
    for node in (node for name in names for node in tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name):
        node.name = f"{part}.{node.name}"
        if isinstance(node, ast.FunctionDef):
            found.append(function_section(node))
        else:
            found.append(section(node) if part != "evalio" else f"## {node.name}\n\n{prose(ast.get_docstring(node) or '')}")
    return found


def text() -> str:
    classes, functions, aliases = definitions()
    errors = "\n".join(f"- `{name}` ({', '.join(ast.unparse(base) for base in classes[name].bases)}): {ast.get_docstring(classes[name])}" for name in ERRORS)
    types = "\n".join(f"- `{name}`: `{aliases[name][0]}`. {aliases[name][1]}" for name in ALIASES)
    return "\n\n".join([HEAD.strip(), *(section(classes[name]) for name in ORDER), *(function_section(functions[name]) for name in FUNCTIONS), *(found for part, names in PARTS.items() for found in part_sections(part, names)), f"## Exceptions\n\n{errors}", f"## Types\n\n{types}"]) + "\n"


def main() -> None:
    if "--check" not in sys.argv[1:]:
        TARGET.write_text(text(), encoding="utf-8")
    elif TARGET.read_text(encoding="utf-8") != text():
        sys.exit(f"{TARGET.name} is out of date: run {Path(__file__).name}")


if __name__ == "__main__":
    main()
