"""What the node of ROS 2 offers, made of its own tables.

```{ros2-outputs}     m100link.apps.ros2.topics.OUTPUTS
```{ros2-inputs}      m100link.apps.ros2.topics.INPUTS
```{ros2-services}    m100link.apps.ros2.topics.SERVICES
```{ros2-actions}     m100link.apps.ros2.actions.FLIGHTS
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from tables import TableDirective

from m100link.apps.ros2.actions import FLIGHTS
from m100link.apps.ros2.topics import INPUTS, OUTPUTS, SERVICES
from m100link.log.cdr import full_name

if TYPE_CHECKING:
    from sphinx.application import Sphinx


class Outputs(TableDirective):
    """Topics that are published."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per topic."""
        yield "Topic", "Type", "Per second", "Quality", "What it is"
        for name, row in OUTPUTS.items():
            quality = "latched" if row.qos.is_latched else "reliable"
            hz = f"{row.hz:g}" if row.hz else "as it happens"
            quality = quality if row.qos.is_reliable else "best effort"
            yield f"``{name}``", f"``{full_name(row.kind)}``", hz, quality, row.text


class Inputs(TableDirective):
    """Topics that are listened to."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per topic."""
        yield "Topic", "Type", "What it does"
        for name, row in INPUTS.items():
            yield f"``{name}``", f"``{full_name(row.kind)}``", row.text


class Services(TableDirective):
    """Services."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per service."""
        yield "Service", "Type", "What it does"
        for name, row in SERVICES.items():
            yield f"``{name}``", f"``{full_name(row.kind)}``", row.text


class Actions(TableDirective):
    """Actions."""

    def rows(self) -> Iterable[Sequence[str]]:
        """One row per action."""
        yield "Action", "Type", "What it does"
        for name, (kind, _, text) in FLIGHTS.items():
            yield f"``{name}``", f"``{kind}``", text


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("ros2-outputs", Outputs)
    app.add_directive("ros2-inputs", Inputs)
    app.add_directive("ros2-services", Services)
    app.add_directive("ros2-actions", Actions)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
