"""Packages that only a part of this one needs: extras of `pip install`."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["missing", "needed"]


def missing(error: ModuleNotFoundError, part: str) -> ImportError:
    """What is raised where the package that `error` names is not installed: it says how to install what the part needs."""
    return ImportError(f"voxelastic.{part} needs the package {error.name}: pip install 'voxelastic[{part}]'", name=error.name)


def needed(name: str, part: str) -> Any:
    """The package of this name, which has no types.

    Raises:
        ImportError: It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise missing(error, part) from None
