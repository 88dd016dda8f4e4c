"""The parts that need further packages, where these are not installed."""

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
    import voxelastic.{part}
    {more}
except ImportError as error:
    print(error)
"""

RUNNER = "from voxelastic.fleet._runner import Runner, Task; list(Runner(object())._by_client('map', []))"


@pytest.mark.parametrize(
    ("part", "absent", "more", "said"),
    [
        ("fleet", ("fsspec", "dask", "distributed"), "", "fsspec"),
        ("fleet", ("distributed",), RUNNER, "distributed"),
        ("notebook", ("anywidget",), "", "anywidget"),
        ("rerun", ("rerun",), "", "rerun"),
        ("evalio", ("evalio",), "", "evalio"),
    ],
)
def test_what_is_not_installed_is_named_with_the_remedy(part: str, absent: tuple[str, ...], more: str, said: str) -> None:
    if part == "fleet":
        pytest.importorskip("fsspec")
    program = WITHOUT.format(part=part, absent=absent, more=more)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == f"voxelastic.{part} needs the package {said}: pip install 'voxelastic[{part}]'\n"
