"""Exceptions. Their messages are those of the command: they name the file, the place in it and what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Error", "FileError", "PlanError", "RefusedError", "RunWarning", "SettingError"]


class Error(Exception):
    """The base of all exceptions of this package that are not mistakes in a call (those are `ValueError` and `TypeError`)."""


class SettingError(Error, ValueError):
    """A setting is unknown or out of range, or settings contradict each other."""


class RefusedError(Error, ValueError):
    """A scan, an edge or a correction cannot be used. The map is unchanged, and mapping can go on."""


class FileError(Error, OSError):
    """A file or a map cannot be read or written, or it is damaged."""


class PlanError(Error):
    """No path was found: the robot does not fit at an end, or within the limits there is no way. The message says which, and what would do."""

    nearest: NDArray[np.float64] | None = None
    """The nearest place where the robot fits, (x, y, z) in the map frame, metres, if it does not fit at an end and fits somewhere within 5 m of it."""


class RunWarning(UserWarning):
    """Something that mapping has to say that is no error: a scan that was left out, a gap in time, a tunnel that does not hold the pose.

    Args:
        text: What happened.
        code: What it is about.
    """

    code: str
    """What it is about, as `--json` of the command and the log of the run have it: `scan-skipped`, `gap`, `degenerate`, ..."""

    def __init__(self, text: str, code: str) -> None:
        super().__init__(text)
        self.code = code
