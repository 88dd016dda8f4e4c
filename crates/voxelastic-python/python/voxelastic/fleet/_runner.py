"""Tasks run here, one after the other, or by the workers of a Dask cluster."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from ._tasks import Record

RETRIES = 2
"""How often Dask tries a task again that failed; one whose worker died it tries again by itself."""


@dataclass(frozen=True)
class Task:
    """A call of a task."""

    key: str
    function: Callable[..., Record]
    arguments: tuple[Any, ...]


@dataclass
class Stage:
    """What the tasks of one kind took."""

    name: str
    tasks: int = 0
    repeated: int = 0
    """Tasks that were not run, because their records were there."""
    failed: int = 0
    wall_seconds: float = 0.0
    seconds_by_worker: dict[str, float] = field(default_factory=dict)
    peak_mb: float = 0.0
    """Largest memory of a worker while it did a task, MB (elsewhere than on Linux: until then)."""
    most_bytes: int = 0
    """Most bytes of a task that pass through the scheduler: its arguments and its record."""
    all_bytes: int = 0

    def add(self, task: Task, record: Record) -> None:
        """Counts a task that is done."""
        size = len(pickle.dumps((task.key, task.arguments))) + len(pickle.dumps(record))
        self.tasks += 1
        self.all_bytes += size
        self.most_bytes = max(self.most_bytes, size)
        if "problem" in record:
            self.failed += 1
        if not record.get("is_new", True):
            self.repeated += 1
            return
        worker = str(record.get("worker", "none"))
        self.seconds_by_worker[worker] = round(self.seconds_by_worker.get(worker, 0.0) + record.get("seconds", 0.0), 3)
        self.peak_mb = max(self.peak_mb, record.get("peak_mb", 0.0))


class Runner:
    """Runs tasks in this process, or by a Dask client.

    Args:
        client: A `distributed.Client`; none for this process.
        progress: Called with the name of the stage, how many of its tasks are done, and how many there are.
    """

    def __init__(self, client: Any = None, progress: Callable[[str, int, int], object] | None = None) -> None:
        self.client, self.progress = client, progress
        self.stages: dict[str, Stage] = {}

    def run(self, stage: str, tasks: Sequence[Task]) -> list[Record]:
        """The records of tasks, in their order. One that fails has the record `{"problem": ..}`; the others go on."""
        counted = self.stages.setdefault(stage, Stage(stage))
        begun = time.perf_counter()
        records: dict[str, Record] = {}
        unique = list({task.key: task for task in tasks}.values())
        for task, record in self._all(stage, unique):
            records[task.key] = record
            counted.add(task, record)
            if self.progress is not None:
                self.progress(stage, len(records), len(unique))
        counted.wall_seconds = round(counted.wall_seconds + time.perf_counter() - begun, 3)
        return [records[task.key] for task in tasks]

    def _all(self, stage: str, tasks: Sequence[Task]) -> Iterator[tuple[Task, Record]]:
        if self.client is None:
            for task in tasks:
                try:
                    yield task, task.function(*task.arguments)
                except Exception as error:  # It is named in the report.
                    yield task, _problem(error)
            return
        import distributed

        # It has no types.
        as_completed: Any = distributed.as_completed
        # Names that the dashboard shows, and by which the scheduler knows a task that is under way already.
        futures = {
            self.client.submit(task.function, *task.arguments, key=f"{stage}-{task.key}", retries=RETRIES): task for task in tasks
        }
        for future in as_completed(list(futures)):
            failure = None if future.status == "finished" else future.exception()
            yield futures[future], future.result() if failure is None else _problem(failure)
            future.release()


def _problem(error: BaseException) -> Record:
    return {"problem": f"{type(error).__name__}: {error}"}
