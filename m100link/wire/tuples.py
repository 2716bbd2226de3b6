"""Named tuples that are made without a constructor in Python.

A named tuple takes 240 ns to make by its name, and 120 ns by ``tuple.__new__``, which looks first
whether it may. A package has twelve records and a frame, a hundred times a second on each line, so
there a class is asked for by what it has below its constructor: 95 ns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from inspect import Signature

__all__ = ["maker", "quick"]

T = TypeVar("T", bound=tuple[Any, ...])


class _Quick(type):
    """The class of such classes: what their constructor does is done here.

    A constructor of their own would stand in the way of :func:`maker`.
    """

    _of_fields: Callable[..., Any]

    def __call__(cls, *values: Any, **named: Any) -> Any:
        return cls._of_fields(cls, *values, **named)

    @property
    def __signature__(cls) -> Signature:
        import inspect  # which takes longer to load than all that is here

        whole = inspect.signature(cls._of_fields)
        return whole.replace(parameters=list(whole.parameters.values())[1:])


def _getnewargs(self: tuple[Any, ...]) -> tuple[tuple[Any, ...]]:
    """For copies and pickles: all values are one argument."""
    return (tuple(self),)


def quick(named: type[T]) -> type[T]:
    """Decorates a class of :class:`typing.NamedTuple`: it is used as before, see :func:`maker`."""
    own = {name: value for name, value in vars(named).items() if name != "__new__"}
    own["_of_fields"] = vars(named)["__new__"]
    own["__getnewargs__"] = _getnewargs
    own["__qualname__"] = named.__qualname__
    made: Any = _Quick(named.__name__, named.__bases__, own)
    return made  # type: ignore[no-any-return]  # the same class to whoever uses it


def maker(named: type[T]) -> Callable[[tuple[Any, ...]], T]:
    """What makes a :func:`quick` class of a tuple of all its values, unchecked, in their order."""
    make: Callable[[tuple[Any, ...]], T] = type.__call__.__get__(named)
    return make
