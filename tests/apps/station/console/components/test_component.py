"""Texts that stand on a page are said again when another language is chosen."""

from __future__ import annotations

from dataclasses import replace

from m100link.apps.station.console.components.component import Wording
from m100link.apps.station.console.view.texts import Language, LengthUnit, Quantity, Settings, tr


def test_what_stands_on_the_page_follows_the_settings() -> None:
    wording, shown = Wording(), [""]
    wording.put(lambda text: shown.__setitem__(0, text), "actions.land")
    assert shown == ["Land (hold)"]
    wording.choose(Settings(language=Language.GERMAN))
    assert shown == ["Landen (halten)"]
    wording.choose(Settings())
    assert shown == ["Land (hold)"]


def test_what_is_said_once_is_said_as_it_was_chosen() -> None:
    wording = Wording()
    near = tr("alarms.guard_near.height", value=Quantity.length(40), limit=Quantity.length(50))
    wording.choose(replace(wording.settings, length=LengthUnit.FOOT))
    assert wording(near) == "Near the limit: 131 ft high of 164 ft"
