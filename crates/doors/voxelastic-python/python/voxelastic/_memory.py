"""A budget for the memory of the process."""

import os
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
