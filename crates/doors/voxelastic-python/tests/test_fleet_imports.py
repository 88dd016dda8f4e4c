"""The part for fleets where its packages are not installed."""

from __future__ import annotations

import subprocess
import sys

import pytest

WITHOUT = """
import importlib.abc, sys

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, *_):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
import voxelastic
try:
    import voxelastic.fleet
    {more}
except ImportError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("absent", "more", "said"),
    [
        (("fsspec", "dask", "distributed"), "", "the package fsspec"),
        (("distributed",), "from voxelastic.fleet._runner import Runner, Task; list(Runner(object())._by_client('map', []))", "the package distributed"),
    ],
)
def test_what_is_not_installed_is_named_with_the_remedy(absent: tuple[str, ...], more: str, said: str) -> None:
    pytest.importorskip("fsspec")
    done = subprocess.run([sys.executable, "-c", WITHOUT.format(absent=absent, more=more)], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == f"voxelastic.fleet needs {said}: pip install 'voxelastic[fleet]'\n"
