"""The packages that only this part needs."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["needed"]


def needed(name: str) -> Any:
    """The package of this name; it has no types.

    Raises:
        ImportError: It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ImportError(f"voxelastic.fleet needs the package {error.name}: pip install 'voxelastic[fleet]'", name=error.name) from None
