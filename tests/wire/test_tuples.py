"""Quick named tuples are used as the others are, and one is made of a tuple of its values."""

from __future__ import annotations

import copy
import inspect
import pickle
from typing import Any, NamedTuple, get_type_hints

import pytest

from m100link.protocol.items import ITEMS
from m100link.wire import Frame
from m100link.wire.frame import maker, quick


@quick
class Point(NamedTuple):
    """A place."""

    north: float
    east: float = 0.0

    @property
    def sum(self) -> float:
        """Both."""
        return self.north + self.east


class Named(Point):
    """A class of its own below it."""

    __slots__ = ()


QUICK = [Point, Named, Frame, *(item.record for item in ITEMS)]


def test_it_is_made_by_its_name_as_before() -> None:
    assert Point(1.0, east=2.0) == Point(1.0, 2.0) == (1.0, 2.0)
    assert Point(1.0).east == 0.0
    assert repr(Named(3.0)) == "Named(north=3.0, east=0.0)"
    assert Point._make([5.0, 6.0])._replace(east=7.0) == Point(5.0, 7.0)
    assert Point(1.0, 2.0).sum == 3.0
    assert Point(1.0, 2.0)._asdict() == {"north": 1.0, "east": 2.0}
    match Named(4.0, 5.0):
        case Point(north, east=5.0):
            assert north == 4.0
        case _:
            pytest.fail("it has no match")


@pytest.mark.parametrize("arguments", [(), (1.0, 2.0, 3.0)])
def test_too_few_and_too_many_values_are_refused(arguments: tuple[float, ...]) -> None:
    with pytest.raises(TypeError):
        Point(*arguments)
    with pytest.raises(TypeError):
        Point(1.0, west=2.0)  # type: ignore[call-arg]  # what is refused


@pytest.mark.parametrize("named", QUICK)
def test_what_is_made_of_a_tuple_is_of_that_class_and_no_other(named: type[Any]) -> None:
    values = tuple(range(len(named._fields)))
    made = maker(named)(values)
    assert type(made) is named
    assert made == values
    assert made == named(*values)
    assert not hasattr(made, "__dict__")
    assert [getattr(made, name) for name in named._fields] == list(values)


@pytest.mark.parametrize("named", QUICK)
def test_it_says_how_it_is_made(named: type[Any]) -> None:
    assert list(inspect.signature(named).parameters) == list(named._fields)
    assert named.__doc__
    assert Point.__qualname__ == "Point"
    assert get_type_hints(Point) == {"north": float, "east": float}


@pytest.mark.parametrize("named", QUICK)
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_it_is_copied_and_pickled(named: type[Any], protocol: int) -> None:
    one = maker(named)(tuple(range(len(named._fields))))
    for other in (copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one, protocol))):
        assert other == one
        assert type(other) is named
