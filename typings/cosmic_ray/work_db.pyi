from collections.abc import Iterator
from contextlib import AbstractContextManager
from enum import Enum
from pathlib import Path

from cosmic_ray.work_item import WorkItem, WorkResult

class WorkDB:
    class Mode(Enum):
        create = 1
        open = 2

    @property
    def work_items(self) -> tuple[WorkItem, ...]: ...
    @property
    def results(self) -> Iterator[tuple[str, WorkResult]]: ...
    def set_result(self, job_id: str, result: WorkResult) -> None: ...

def use_db(path: Path, mode: WorkDB.Mode = ...) -> AbstractContextManager[WorkDB]: ...
