"""The flight mode commands: one at a time, the result kept (document 2.2.2.2).

::

    IDLE       --start, conditions met--> EXECUTING   answer 2; not met: answer 1, nothing changes
    EXECUTING  --start-->                 EXECUTING   answer 1
    EXECUTING  --query-->                 EXECUTING   answer 3, with another sequence number 1
    EXECUTING  --end-->                   SUCCEEDED or FAILED
    ended      --query-->                 ended       answer 5 or 4, with another sequence number 1
    ended      --start-->                 like IDLE
"""

from __future__ import annotations

from enum import Enum

from m100link.protocol.codes import TaskResultCode, TaskStartCode
from m100link.protocol.commands.control import Task

__all__ = ["TaskMachine", "TaskState"]


class TaskState(Enum):
    """Where the current task stands, and what a query is answered."""

    IDLE = TaskResultCode.NOT_CURRENT
    EXECUTING = TaskResultCode.EXECUTING
    SUCCEEDED = TaskResultCode.SUCCEEDED
    FAILED = TaskResultCode.FAILED


class TaskMachine:
    """The one task that is or was executed last.

    Attributes:
        state: Its state.
        task: Which, or None before the first.
        task_sequence: The number that the onboard device gave it.
    """

    __slots__ = ("state", "task", "task_sequence")

    def __init__(self) -> None:
        self.state = TaskState.IDLE
        self.task: Task | None = None
        self.task_sequence: int | None = None

    @property
    def is_executing(self) -> bool:
        """Whether a task is under way."""
        return self.state is TaskState.EXECUTING

    def start(self, task_sequence: int, task: Task | None, conditions_met: bool) -> TaskStartCode:
        """Answer 0x01/0x01. ``task`` is None for a number that is not a task."""
        if self.is_executing or task is None or not conditions_met:
            return TaskStartCode.REJECTED
        self.state = TaskState.EXECUTING
        self.task = task
        self.task_sequence = task_sequence
        return TaskStartCode.STARTED

    def query(self, task_sequence: int) -> TaskResultCode:
        """Answer 0x01/0x02; the result may be asked for any number of times."""
        if task_sequence != self.task_sequence:
            return TaskResultCode.NOT_CURRENT
        return TaskResultCode(self.state.value)

    def end(self, succeeded: bool) -> None:
        """Keep the result of the task under way; without one, nothing happens."""
        if self.is_executing:
            self.state = TaskState.SUCCEEDED if succeeded else TaskState.FAILED
