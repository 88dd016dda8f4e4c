"""The examples of the book's chapter run as they stand there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PACKAGE = Path(__file__).resolve().parents[1]
CHAPTER = PACKAGE.parents[2] / "docs" / "src" / "python" / "index.md"


def test_the_chapter_says_what_happens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", CHAPTER.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) == 8
    subprocess.run([sys.executable, "-m", "voxelastic", "simulate", "room", "-o", "drive", "--scans", "6", "--sensor", "vlp-16", "-q"], check=True)
    for block in blocks:
        exec(compile(block, str(CHAPTER), "exec"), names)
    room, found, path = names["room"], names["found"], names["path"]
    assert path.length < 3.3 and path.least_clearance >= 0.3 and np.isfinite(names["points"]).any() and names["hits"].distance.shape == (2,)
    assert repr(room).startswith("Map(5 scans, 1 submaps, voxels of 0.05 m, ") and len(names["mesh"]) > 1000
    assert abs(found.distance[0] - 0.02) < 0.01 and np.isnan(found.distance[1:]).all() and found.gradient[0][0] < -0.9
    assert found.observed.tolist() == [True, True, False]
    np.testing.assert_allclose(names["report"].pose[:3, 3], [1.2, 0, 0], atol=0.03)
    assert names["found_again"].is_certain and names["measured"]["accuracy_exact"]["median"] < 0.02
    np.testing.assert_allclose(names["found_again"].pose[:3, 3], [0.5, 0.2, 0], atol=0.05)
    before, after = ([submap.pose[0, 3] for submap in names[name].submaps] for name in ("before", "after"))
    np.testing.assert_allclose(after[0], 1.1 * before[0])
    np.testing.assert_array_equal(names["again"].mesh().vertices, names["walk"].mesh().vertices)


def test_the_reference_is_that_of_the_docstrings() -> None:
    subprocess.run([sys.executable, PACKAGE / "generate_reference.py", "--check"], check=True)
