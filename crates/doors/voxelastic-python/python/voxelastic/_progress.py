"""How far a long call is."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias, Union

__all__ = ["Progress", "reported"]

Progress: TypeAlias = Union[Callable[[int], object], bool, None]
"""Who is told how far a long call is. By default (none), a bar is shown if the package tqdm is installed and a person is there to see it: in a terminal or a notebook.
True: a bar in any case; false: no bar. A function is called now and then with the number of scans since the last call."""


@contextmanager
def reported(progress: Progress, total: int | None, unit: str) -> Iterator[Callable[[int], object]]:
    """What to call with each number of things done; a bar is closed in the end.

    Raises:
        ImportError: A bar is asked for, and tqdm is not installed.
    """
    if callable(progress):
        yield progress
        return
    bar = _bar(progress, total, unit)
    if bar is None:
        yield lambda _: None
        return
    with bar:
        yield bar.update


def _bar(progress: bool | None, total: int | None, unit: str) -> Any:
    """A bar of tqdm; none if it is not wanted."""
    if progress is False or (progress is None and not (sys.stderr is not None and sys.stderr.isatty()) and not _is_notebook()):
        return None
    try:
        tqdm: Any = importlib.import_module("tqdm")
    except ImportError:
        if progress is None:
            return None
        raise
    return tqdm.tqdm(total=total, unit=f" {unit}")


def _is_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    return "ipykernel" in sys.modules and hasattr(sys.modules.get("IPython"), "get_ipython")
