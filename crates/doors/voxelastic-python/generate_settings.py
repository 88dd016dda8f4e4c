#!/usr/bin/env python3
"""Writes python/voxelastic/_settings.py from the one definition of the settings, in the native part of the installed package.

    python crates/doors/voxelastic-python/generate_settings.py            write it
    python crates/doors/voxelastic-python/generate_settings.py --check    fail if it is out of date
"""

import importlib.util
import sys
import textwrap
from pathlib import Path
from typing import Any

TARGET = Path(__file__).resolve().parent / "python" / "voxelastic" / "_settings.py"

HEAD = '''"""The settings of the mapper. Written by generate_settings.py: do not edit."""

from __future__ import annotations

import dataclasses
import numbers
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from . import _native

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["SettingArguments", "Settings"]


class SettingArguments(TypedDict, total=False):
    """Settings as keyword arguments: the attributes of `Settings`."""

'''

CLASS = '''

@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Settings:
    """Settings of the mapper, each with its unit, range and default; checked when they are made. They can be compared, copied and pickled.

    Lengths are metres and angles degrees. `Settings(voxel_size=0.1).replace(max_range=30)` changes some of them.

    Raises:
        TypeError: A value is of another type: text instead of a number, or a number with a fraction instead of a whole one.
        SettingError: A value is out of range, or settings contradict each other.
    """

'''

TAIL = '''
    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _of_type(field.name, str(field.type), getattr(self, field.name)))
        _native.complete_settings(self.as_text())

    def __repr__(self) -> str:
        changed = (field for field in dataclasses.fields(self) if getattr(self, field.name) != field.default)
        return f"Settings({', '.join(f'{field.name}={getattr(self, field.name)!r}' for field in changed)})"

    def as_text(self) -> dict[str, str]:
        """All settings as text, as in configuration files: by name."""
        return {field.name: str(getattr(self, field.name)) for field in dataclasses.fields(self)}

    @classmethod
    def from_text(cls, text: dict[str, str]) -> Self:
        """Settings from text, as in configuration files; those that are absent have their defaults.

        Raises:
            SettingError: A setting is unknown or out of range, or settings contradict each other.
        """
        kinds: dict[str, Any] = {field.name: type(field.default) for field in dataclasses.fields(cls)}
        return cls(**{name: kinds[name](value) for name, value in _native.complete_settings(text)})

    def replace(self, **changes: Any) -> Self:
        """The same settings with some changes, given as keyword arguments.

        Raises:
            SettingError: A setting is unknown or out of range, or settings contradict each other.
        """
        known = {field.name for field in dataclasses.fields(self)}
        if unknown := [name for name in changes if name not in known]:
            # Refused, with the name that may be meant.
            _native.complete_settings({name: str(changes[name]) for name in unknown})
        return dataclasses.replace(self, **changes)


def _of_type(name: str, kind: str, value: Any) -> Any:
    """The value of a setting as the type that it is annotated with."""
    is_whole, is_number = (isinstance(value, which) and not isinstance(value, bool) for which in (numbers.Integral, numbers.Real))
    match kind:
        case "int" if is_whole:
            return int(value)
        case "float" if is_number:
            return value if isinstance(value, int | float) else float(value)
        case "str | float" if is_number:
            return str(int(value) if is_whole else float(value))
        case "str | float" | "str" if isinstance(value, str):
            return value
        case _ if kind.startswith("Literal") and isinstance(value, str):
            return value
    expected = {"int": "a whole number (int)", "float": "a number (float)", "str": "text (str)", "str | float": "a number (float) or text (str)"}
    raise TypeError(f"{name}: expected {expected.get(kind, 'text (str)')}, not {value!r} of type {type(value).__name__}")
'''


def table() -> list[tuple[str, str, str, str, bool, str]]:
    """The definition, from the native part alone: the package cannot be imported before the file is there."""
    package = importlib.util.find_spec("voxelastic")
    if package is None or package.origin is None:
        sys.exit("the package voxelastic is not installed")
    spec = importlib.util.spec_from_file_location("_native", next(Path(package.origin).parent.glob("_native.*[!i]")))
    assert spec is not None and spec.loader is not None
    native: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(native)
    return native.settings_table()  # type: ignore[no-any-return]


def type_of(kind: str) -> str:
    return kind if kind in ("float", "int", "str", "str | float") else f"Literal[{', '.join(repr(word) for word in kind.split('|'))}]".replace("'", '"')


def value_of(kind: str, default: str) -> str:
    return {"float": lambda: repr(float(default)), "int": lambda: default}.get(kind, lambda: f'"{default}"')()


def text() -> str:
    settings = table()
    arguments = "".join(f"    {key}: {type_of(kind)}\n" for key, kind, *_ in settings)
    attributes = []
    for key, kind, default, allowed, _, words in settings:
        help = textwrap.wrap(f"{words} Allowed: {allowed}.", 130, break_on_hyphens=False)
        doc = f'"""{help[0]}"""' if len(help) == 1 else '"""' + "\n    ".join(help) + '\n    """'
        attributes.append(f"    {key}: {type_of(kind)} = {value_of(kind, default)}\n    {doc}\n")
    return HEAD + arguments + CLASS + "".join(attributes) + TAIL


def main() -> None:
    if "--check" not in sys.argv[1:]:
        TARGET.write_text(text(), encoding="utf-8")
    elif TARGET.read_text(encoding="utf-8") != text():
        sys.exit(f"{TARGET.name} is out of date: run {Path(__file__).name}")


if __name__ == "__main__":
    main()
