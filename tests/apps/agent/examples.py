"""An example of each order, made of the kinds of its fields: a new order needs none by hand."""

from __future__ import annotations

import dataclasses
from typing import Any, get_type_hints

from m100link.apps.agent.orders import ORDERS, CameraUse, Order
from m100link.protocol.commands.gimbal import GimbalAngle, GimbalSpeed
from m100link.protocol.commands.hotpoint import HotpointStart

_CIRCLE = HotpointStart(latitude=0.9, longitude=0.07, altitude=20, radius=8.5, angular_rate=3.5)
_VALUES: dict[Any, Any] = {
    **{int: 1, float: 5.0, bool: True, str: "seek 3", bytes: b"\x02\xff", float | None: -90.5},
    tuple[bytes, ...]: (b"", b"\x01\xff"),
    **{CameraUse: CameraUse.START_VIDEO, HotpointStart: _CIRCLE},
    **{GimbalAngle: GimbalAngle(1.5, -2.5, -45.0), GimbalSpeed: GimbalSpeed(1.5, -2.5, -45.0)},
}


def example(kind: type[Order]) -> Order:
    """An order of that kind."""
    hints = get_type_hints(kind)
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]  # a dataclass by __init_subclass__
    values = {one.name: hints[one.name] for one in fields}
    for name, hint in values.items():
        assert hint in _VALUES, f"{__file__}: _VALUES has no {hint}, as {kind.__name__}.{name} is"
    return kind(**{name: _VALUES[hint] for name, hint in values.items()})


EXAMPLES = [example(kind) for kind in ORDERS.values()]
