"""The pipeline for evalio, run by evalio."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

RECIPES = Path(__file__).with_name("recipes")
PROGRAM = "import sys; from evalio.cli import app; sys.argv = ['evalio', *sys.argv[1:]]; app()"

pytest.importorskip("evalio")


def test_evalio_runs_the_odometry(tmp_path: Path) -> None:
    environment = os.environ | {"EVALIO_CUSTOM": "voxelastic.evalio,evalio_walk", "PYTHONPATH": str(RECIPES), "EVALIO_DATA": str(tmp_path)}
    words = ["run", "-d", "simulated_walk/room", "-p", "voxelastic", "-o", str(tmp_path / "results")]
    done = subprocess.run([sys.executable, "-c", PROGRAM, *words], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    made = tmp_path / "results" / "simulated_walk" / "room"
    estimate, truth = (np.loadtxt(made / name, delimiter=",", comments="#") for name in ("voxelastic.csv", "gt.csv"))
    assert "status: complete" in (made / "voxelastic.csv").read_text()
    assert len(estimate) == len(truth) == 40 and np.array_equal(estimate[:, 0], truth[:, 0])
    # Both in the frame of the fifth pose of the inertial unit: how it moves is not known in the first sweep, which stays distorted, by the 8 cm that it takes.
    moved = [in_first(rows[4:]) for rows in (estimate, truth)]
    off = np.linalg.norm(moved[0] - moved[1], axis=1)
    assert off.max() < 0.05 and np.linalg.norm(moved[1], axis=1).max() > 2, off


def in_first(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions in the frame of the first pose, of rows with time, position and quaternion."""
    x, y, z, w = rows[0, 4:8]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    positions: NDArray[np.float64] = (rows[:, 1:4] - rows[0, 1:4]) @ turn
    return positions


def test_parameters_are_those_of_the_odometry() -> None:
    from evalio.pipelines import all_pipelines
    from evalio.types import LidarParams

    from voxelastic.evalio import Voxelastic

    assert all_pipelines()["voxelastic"] is Voxelastic
    pipeline = Voxelastic()
    assert pipeline.set_params({"voxel_size": 0.3, "deskew": False, "colour": "red"}) == {"colour": "red"}
    pipeline.set_lidar_params(LidarParams(num_rows=16, num_columns=512, min_range=1.0, max_range=-1.0))
    with pytest.raises(ValueError, match="max_range"):
        pipeline.initialize()
