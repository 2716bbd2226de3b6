"""What every error of the package has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar, Self, TypeVar

__all__ = ["M100Error", "OutOfResources", "of_the_system"]

E = TypeVar("E", bound="M100Error")


class M100Error(Exception):
    """Base of every error of this package.

    Each class of this package has a code of its own, which stays when a text changes; a class that
    is derived from one elsewhere has that of its base.

    Attributes:
        error_code: ``M100-`` and words, such as ``M100-LINK-LOST``.
        usual_cause: What mostly causes errors of this class.
        usual_remedy: What mostly helps.
        seen: What was observed, in one sentence.
        cause: The most likely cause, or an empty string.
        remedy: What to do about it, or an empty string.
    """

    error_code: ClassVar[str] = "M100-ERROR"
    usual_cause: ClassVar[str] = "what no other class of errors describes"
    usual_remedy: ClassVar[str] = "read what was seen"

    def __init_subclass__(cls, *, code: str = "", cause: str = "", remedy: str = "") -> None:
        super().__init_subclass__()
        cls.error_code = code or cls.error_code
        cls.usual_cause = cause or cls.usual_cause
        cls.usual_remedy = remedy or cls.usual_remedy

    @property
    def manual(self) -> str:
        """Page and anchor of the manual that describe this class of errors."""
        return f"reference/errors#{self.error_code.lower()}"

    def __init__(self, seen: str, *, cause: str = "", remedy: str = "") -> None:
        self.seen = seen
        self.cause = cause
        self.remedy = remedy
        super().__init__(seen, cause, remedy)

    def __str__(self) -> str:
        text = self.seen
        if self.cause:
            text += f"\n  likely cause: {self.cause}"
        if self.remedy:
            text += f"\n  what to do:   {self.remedy}"
        return text

    def again(self) -> Self:
        """The same error, to be raised in another place: one exception object has one traceback."""
        fresh = _rebuild(type(self), self.args, self.__dict__)
        fresh.__cause__ = self.__cause__
        return fresh

    def __reduce__(self) -> tuple[object, ...]:
        # Subclasses take keyword arguments that the default pickling would lose.
        return (_rebuild, (type(self), self.args, self.__dict__))


class OutOfResources(
    M100Error,
    OSError,
    code="M100-OUT-OF-RESOURCES",
    cause="the program leaks file descriptors or threads, or the disk of its modules fails",
    remedy="look at `/proc/<pid>/fd` and the system's log; start the program anew",
):
    """The system has no file, thread or memory for what was asked; nothing was sent.

    The system's own error is chained.
    """


@contextmanager
def of_the_system(what: str) -> Iterator[None]:
    """What the system does not give for ``what`` is raised as an error of this package.

    Raises:
        OutOfResources: There is no file, module, descriptor, thread or memory for it.
    """
    try:
        yield
    except M100Error:
        raise
    except (OSError, ImportError, MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "thread" not in str(error):
            raise  # Python has no class of its own for "can't start new thread"
        raise OutOfResources(
            f"{what} was not asked for: {error}",
            cause=OutOfResources.usual_cause,
            remedy=OutOfResources.usual_remedy,
        ) from error


def _rebuild(cls: type[E], args: tuple[object, ...], attributes: dict[str, object]) -> E:
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(attributes)
    return error
