"""Services that do something: done, or why not, with cause and remedy."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from m100link.apps.ros2.ends import Call
from m100link.errors import M100Error

__all__ = ["answering", "trigger"]


def answering(doing: Callable[[Mapping[str, Any]], Awaitable[None]], done: str) -> Call:
    """A service whose answer is ``success`` and ``message``.

    Args:
        doing: Does what is asked for; its errors are the refusal.
        done: What is told when it is done.
    """

    async def call(request: dict[str, Any]) -> Mapping[str, Any]:
        try:
            await doing(request)
        except M100Error as error:
            return {"success": False, "message": str(error)}
        return {"success": True, "message": done}

    return call


def trigger(doing: Callable[[], Awaitable[None]], done: str) -> Call:
    """The same without a question."""
    return answering(lambda _: doing(), done)
