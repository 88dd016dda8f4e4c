"""The packages that only this part needs."""

from __future__ import annotations

from typing import Any

from .. import _needs

__all__ = ["needed"]


def needed(name: str) -> Any:
    """The package of this name; it has no types.

    Raises:
        ImportError: It is not installed.
    """
    return _needs.needed(name, "fleet")
