"""The base class of every error of the package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar, dataclass_transform

__all__ = ["M100Error", "OutOfResources"]

E = TypeVar("E", bound="M100Error")

if TYPE_CHECKING:
    from dataclasses import field

    @dataclass_transform(kw_only_default=True, eq_default=False, field_specifiers=(field,))
    class _Keywords(Exception):
        """The constructor takes what its class annotates, by keyword."""

else:
    _Keywords = Exception


class M100Error(_Keywords):
    """Base of every error of this package.

    Each class of this package has a code of its own, which stays when a text changes; a class that
    is derived from one elsewhere has that of its base. It is made of what was ``seen`` and, by
    keyword, of the other attributes that its class annotates, each with a default.

    Attributes:
        error_code: ``M100-`` and words, such as ``M100-LINK-LOST``.
        usual_cause: The usual cause of errors of this class.
        usual_remedy: The usual remedy.
        seen: The observation, in one sentence.
        cause: The most likely cause, or an empty string.
        remedy: The remedy, or an empty string.
    """

    error_code: ClassVar[str] = "M100-ERROR"
    usual_cause: ClassVar[str] = "what no other class of errors describes"
    usual_remedy: ClassVar[str] = "read what was seen"
    own: ClassVar[dict[str, Any]] = {}
    """The attributes that its class adds to those of all errors, with the defaults."""

    if TYPE_CHECKING:
        seen: str = field(kw_only=False)
        cause: str = ""
        remedy: str = ""

    def __init_subclass__(cls, *, code: str = "", cause: str = "", remedy: str = "") -> None:
        super().__init_subclass__()
        cls.error_code = code or cls.error_code
        cls.usual_cause = cause or cls.usual_cause
        cls.usual_remedy = remedy or cls.usual_remedy
        annotated = vars(cls).get("__annotations__", ())  # as they stand: nothing evaluates them
        # A program's class, in a module without the future import.
        if sys.version_info >= (3, 14) and "__annotate_func__" in vars(cls):
            from annotationlib import Format, get_annotations

            annotated = get_annotations(cls, format=Format.FORWARDREF)
        bases = [base.own for base in reversed(cls.__bases__) if issubclass(base, M100Error)]
        bases += [{name: vars(cls)[name] for name in annotated if name in vars(cls)}]
        cls.own = {name: default for one in bases for name, default in one.items()}

    @property
    def manual(self) -> str:
        """Page and anchor of the manual that describe this class of errors."""
        return f"reference/errors#{self.error_code.lower()}"

    def __init__(self, seen: str, *, cause: str = "", remedy: str = "", **data: object) -> None:
        if unknown := data.keys() - self.own.keys():
            raise TypeError(f"{type(self).__name__} has no {', '.join(sorted(unknown))}")
        self.seen = seen
        self.cause = cause
        self.remedy = remedy
        known = {name: one for name, one in data.items() if one is not None}
        vars(self).update({name: copy(default) for name, default in self.own.items()} | known)
        super().__init__(seen, cause, remedy)

    @classmethod
    def usual(cls, seen: str) -> Self:
        """The error with the cause and the remedy that are usual for it."""
        return cls(seen, cause=cls.usual_cause, remedy=cls.usual_remedy)

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
    """The system has no file, thread or memory for the call; nothing was sent.

    The system's own error is chained.
    """


@contextmanager
def of_the_system(what: str) -> Iterator[None]:
    """Raise ``OutOfResources`` where the system has no file, module, thread or memory for it."""
    try:
        yield
    except M100Error:
        raise
    except (OSError, ImportError, MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "thread" not in str(error):
            raise  # Python has no class of its own for "can't start new thread"
        raise OutOfResources.usual(f"{what} was not asked for: {error}") from error


def _rebuild(cls: type[E], args: tuple[object, ...], attributes: dict[str, object]) -> E:
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(attributes)
    return error
