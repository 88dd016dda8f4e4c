"""The command `voxelastic`, in the process of the interpreter: also `python -m voxelastic`."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

from . import _native


def main() -> NoReturn:
    """Runs the command with the arguments of this process and exits with its code."""
    # Without this, Ctrl-C would wait until the command is done; the long ones have handlers of their own, which save what there is.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = _native.run_command(["voxelastic", *sys.argv[1:]])
    # At once: there is nothing to clean up, and threads of the command may still be about to end.
    sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    main()
