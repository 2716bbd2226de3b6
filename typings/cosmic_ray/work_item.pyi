from enum import StrEnum
from pathlib import Path

class TestOutcome(StrEnum):
    SURVIVED = "survived"
    KILLED = "killed"
    INCOMPETENT = "incompetent"

class WorkerOutcome(StrEnum):
    NORMAL = "normal"
    SKIPPED = "skipped"

class MutationSpec:
    module_path: Path
    operator_name: str
    start_pos: tuple[int, int]

class WorkItem:
    job_id: str
    mutations: tuple[MutationSpec, ...]

class WorkResult:
    test_outcome: TestOutcome | None
    def __init__(self, worker_outcome: WorkerOutcome) -> None: ...
