"""The texts of a page in the language and units of whoever looks at it, also when these change."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from m100link.apps.station.console.view.settings import Settings
from m100link.apps.station.console.view.words import Text, say

__all__ = ["Wording", "attribute"]


class Wording:
    """Says texts, and says those again that stand on the page when another language is chosen.

    Attributes:
        settings: What the operator chose.
        utc_offset_min: Minutes that the operator's clock is ahead of UTC.
    """

    def __init__(self) -> None:
        self.settings = Settings()
        self.utc_offset_min = 0
        self._followers: list[Callable[[], object]] = []

    def __call__(self, text: Text) -> str:
        """The text as it is shown now."""
        return self.settings.speaker(text)

    def put(self, show: Callable[[str], object], key: str, **values: object) -> None:
        """Let a text stand on the page, now and after every change of the settings.

        Args:
            show: Shows it, such as the ``set_text`` of a label.
            key: Of the entry in the catalogue.
            values: What stands in its braces.
        """
        text = say(key, **values)
        self.follow(lambda: show(self(text)))

    def follow(self, show: Callable[[], object]) -> None:
        """Call this now and after every change of the settings."""
        self._followers.append(show)
        show()

    def choose(self, settings: Settings) -> None:
        """Take other settings."""
        self.settings = settings
        for show in self._followers:
            show()


def attribute(element: ui.element, name: str = "aria-label") -> Callable[[str], None]:
    """What sets an attribute of an element, where a text is not its content."""

    def show(text: str) -> None:
        if element.props.get(name) != text:
            element.props[name] = text
            element.update()

    return show
