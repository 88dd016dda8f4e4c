"""The examples of the book's chapter run as they stand there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CHAPTER = Path(__file__).resolve().parents[3] / "docs" / "src" / "python" / "index.md"


def test_the_chapter_says_what_happens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", CHAPTER.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, str(CHAPTER), "exec"), names)
    room, found = names["room"], names["found"]
    assert repr(room).startswith("Map(5 scans, 1 submaps, voxels of 0.05 m, ") and len(names["mesh"]) > 1000
    assert abs(found.distance[0] - 0.02) < 0.01 and np.isnan(found.distance[1:]).all() and found.gradient[0][0] < -0.9
    assert found.observed.tolist() == [True, True, False]
    before, after = ([submap.pose[0, 3] for submap in names[name].submaps] for name in ("before", "after"))
    np.testing.assert_allclose(after[0], 1.1 * before[0])
