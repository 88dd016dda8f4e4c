"""A budget for the memory of the process."""

import ctypes
import os
import threading
from typing import Optional, Union

from . import _native

__all__ = ["limit_memory"]


def limit_memory(size: Union[int, str], folder: Optional[Union[str, os.PathLike[str]]] = None) -> None:
    """Limits the memory of this process, as far as it is memory of maps, for maps that are larger than it.

    Args:
        size: the budget for all resident memory of the process: bytes, or text such as "500MB", "2GB" or "1.5GiB"; 0 or "none" removes it.
        folder: where the file is for what is beyond it. It needs a disk with room for all maps; by default it is `TMPDIR`, or `/var/tmp`. The folder of the
            first call serves all later ones.

    Maps that are made or opened from then on are kept in a file without a name, of which only so much is in memory as the budget allows: what was made
    first leaves first, and comes back when it is asked for. No result depends on it. `Mapper(memory="500MB")` sets it as well.

    Raises:
        SettingError: the text is not a size, or the folder cannot be used.
    """
    _native.limit_memory(str(size) + "B" if isinstance(size, int) and size else str(size or "none"), folder)


# Of malloc.h, and what the GNU C library sets by itself in a process that has freed an array of 32 MB.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT_AT_MOST, _MAPPED_FROM = 64 << 20, 32 << 20
_giving_back = threading.Lock()


def give_back() -> None:
    """Gives memory that was freed back to the system. The GNU C library keeps it otherwise: up to 64 MB at the end of each thread's memory, and all gaps."""
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt") or not hasattr(library, "malloc_trim"):
        return
    with _giving_back:
        library.mallopt(_TRIM_THRESHOLD, 0)
        _native.free_in_every_thread()
        library.mallopt(_TRIM_THRESHOLD, _KEPT_AT_MOST)
        library.mallopt(_MMAP_THRESHOLD, _MAPPED_FROM)
        library.malloc_trim(0)
