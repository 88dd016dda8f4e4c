"""Tasks run here, one after the other, or by the workers of a Dask cluster."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from ._needs import needed
from ._tasks import Record

RETRIES = 2
"""How often a task is tried again that failed. One whose worker died counts as failed when Dask gives it up, by default with the fourth worker."""
SCHEDULERS = 10
"""How often a stage goes on with another scheduler, after one that was restarted."""


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
        yield from self._by_client(stage, tasks)

    def _by_client(self, stage: str, tasks: Sequence[Task]) -> Iterator[tuple[Task, Record]]:
        as_completed = needed("distributed").as_completed
        left = {task.key: task for task in tasks}
        deaths: dict[str, int] = dict.fromkeys(left, 0)
        for attempt in range(1 + SCHEDULERS):
            futures = self._submit(stage, left.values(), attempt)
            for done in as_completed(list(futures)).batches():
                # All that is done is fetched before anybody is told of it: a scheduler that is lost meanwhile does not take it along.
                for future, record in [(future, _outcome(future)) for future in done]:
                    task = futures[future]
                    if record is not None and record.pop("is_killed", False) and deaths[task.key] < RETRIES:
                        deaths[task.key] += 1
                    elif record is not None:
                        yield left.pop(task.key), record
                    future.release()
            if not left:
                return
        raise ConnectionError(f"{stage}: the Dask scheduler was lost {1 + SCHEDULERS} times; what is done is in the store: run again to go on")

    def _submit(self, stage: str, tasks: Iterable[Task], attempt: int) -> dict[Any, Task]:
        """Tasks on their way, by their futures."""
        self._wait_for_scheduler(stage)
        # The scheduler would answer a name that it knows with what became of that.
        again = f"-{attempt}" if attempt else ""
        try:
            # Names that the dashboard shows, and by which the scheduler knows a task that is under way already.
            return {self.client.submit(task.function, *task.arguments, key=f"{stage}-{task.key}{again}", retries=RETRIES): task for task in tasks}
        except Exception:  # Of a client that gave up just now.
            self._wait_for_scheduler(stage)
            raise

    def _wait_for_scheduler(self, stage: str) -> None:
        """Waits for a scheduler that does not answer. The client connects again by itself, or gives up."""
        while self.client.status == "connecting":
            time.sleep(0.1)
        if self.client.status != "running":
            raise ConnectionError(f"{stage}: the Dask scheduler does not answer any more; what is done is in the store: start it and run again to go on")


def _outcome(future: Any) -> Record | None:
    """The record of a task that is done; none if the scheduler does not know it any more, because it is another one. `is_killed` says that its workers died."""
    distributed = needed("distributed")
    cancelled, killed = distributed.CancelledError, distributed.scheduler.KilledWorker
    try:
        if future.status == "finished":
            record: Record = future.result()
            return record
        failure = None if future.status in ("cancelled", "lost") else future.exception()
        return None if failure is None else _problem(failure) | {"is_killed": isinstance(failure, killed)}
    except (cancelled, OSError):  # While it was asked.
        return None


def _problem(error: BaseException) -> Record:
    return {"problem": f"{type(error).__name__}: {error}"}
