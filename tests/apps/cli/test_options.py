"""Options made from dataclasses: one declaration, and what becomes of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import pytest

pytest.importorskip("cyclopts")
from m100link.apps.cli.common import AppOptions
from m100link.apps.cli.options import attribute_texts, options_of
from m100link.apps.cli.serve import StationOptions, settings_of
from m100link.apps.cli.sim import AssistantOptions, FaultOptions, MissionOptions, SiteOptions
from m100link.apps.station.config import ENVIRONMENT, Settings
from m100link.protocol.commands.activation import Credentials
from m100link.sim import NO_FAULTS, AircraftSettings, AssistantSettings, LineFaults, MissionSettings


@dataclass(frozen=True)
class Kitchen:
    """A kitchen.

    Attributes:
        stove: What cooks,
            and how hot.
        pans: A pan.
        lamp: What shines.

    Raises:
        Nothing: At all.
    """

    stove: int = 5
    pans: tuple[str, ...] = ()
    lamp: Path | None = None


def test_texts_come_from_the_docstring() -> None:
    assert attribute_texts(Kitchen) == {
        "stove": "What cooks, and how hot.",
        "pans": "A pan.",
        "lamp": "What shines.",
    }


def test_options_have_the_defaults_of_their_fields_or_none_as_a_layer() -> None:
    plain = options_of(Kitchen, ("stove", "lamp"))()
    assert (plain.stove, plain.lamp) == (5, None)
    layer = options_of(Kitchen, ("stove", "pans"), is_layer=True)()
    assert (layer.stove, layer.pans) == (None, ())
    with pytest.raises(LookupError, match="Kitchen has no line for oven"):
        options_of(Kitchen, ("oven",))


def test_every_setting_is_declared_once() -> None:
    names = {one.name for one in fields(Settings)}
    assert set(attribute_texts(Settings)) == names
    assert set(ENVIRONMENT) <= names
    own = {"launch", "run"}
    offered = {one.name for one in fields(StationOptions)} - own
    assert offered == names - {
        *("url", "key", "token", "console_port", "tiles", "video", "origins"),
        "unused",
    }
    defaults = {one.name: one.default for one in fields(Credentials)}
    for name in ("level", "app_version", "bundle_id"):
        assert getattr(Settings(), name) == defaults[name]
        assert getattr(AppOptions(), name) is None


def test_what_was_not_given_is_left_to_the_other_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("M100LINK_PORT", "1234")
    settings = settings_of(StationOptions(also_ports=(19871,), level=1), url="tcp://a:1")
    assert (settings.port, settings.also_ports, settings.level) == (1234, (19871,), 1)
    assert settings.origins == {
        "also_ports": "command line",
        "level": "command line",
        "url": "command line",
        "port": "environment",
    }


def test_every_fault_of_the_line_is_an_option_and_the_site_is_that_of_the_library() -> None:
    assert [one.name for one in fields(FaultOptions)] == [one.name for one in fields(LineFaults)]
    assert FaultOptions().faults() == NO_FAULTS
    assert FaultOptions(loss=0.5, baud_rate=9600).faults() == LineFaults(loss=0.5, baud_rate=9600)
    missions = MissionOptions().settings()
    assert missions == MissionSettings()
    site = SiteOptions().settings(missions)
    assert site == AircraftSettings(noise=1.0)  # people want to see noise
    assert AssistantOptions().settings(cold=False) == AssistantSettings()
