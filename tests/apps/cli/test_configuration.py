"""The user's configuration file: where it is, what it may say, and what it comes before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclopts")
from m100link.apps.cli.configuration import (
    Configuration,
    configuration_path,
    read_configuration,
    remember,
)
from m100link.apps.cli.terminal import ExitCode
from m100link.errors import BadURL, UsageError
from m100link.sim.vehicle.activation import DEMO_APP_ID
from tests.apps.cli.conftest import CommandLine

FILE = """
[defaults]
aircraft = "lab-m100"
app_id = 77
key_file = "m100.key"
timeout = 5

[aircraft.lab-m100]
url = "/dev/m100-that-does-not-exist"
baud = 921600
firmware = "3.1"
level = 1

[aircraft.virtual]
url = "sim://?firmware=2.3"

[aircraft.other]
url = "tcp://127.0.0.1:1"
app_id = 78
key_file = "/etc/m100/other.key"

[station]
port = 19877
pages = "pages"
"""


@pytest.fixture
def file(configuration_file: Path) -> Path:
    configuration_file.write_text(FILE, encoding="utf-8")
    return configuration_file


# -- where it is ----------------------------------------------------------------------------------


def test_it_is_where_the_platform_has_such_files() -> None:
    home = Path.home()
    assert configuration_path({}, "linux") == home / ".config/m100link.toml"
    assert configuration_path({"XDG_CONFIG_HOME": "/x"}, "linux") == Path("/x/m100link.toml")
    assert configuration_path({"XDG_CONFIG_HOME": "x"}, "linux") == home / ".config/m100link.toml"
    library = home / "Library/Application Support/m100link.toml"
    assert configuration_path({"APPDATA": "/a"}, "darwin") == library
    assert configuration_path({"APPDATA": "/a"}, "win32") == Path("/a/m100link.toml")
    assert configuration_path({}, "win32") == home / "AppData/Roaming/m100link.toml"


def test_without_a_file_nothing_is_said(configuration_file: Path) -> None:
    configuration = read_configuration()
    assert (configuration.path, configuration.exists) == (configuration_file, False)
    assert all(not values for _, values in configuration.sources("sim://"))
    assert all(not values for _, values in configuration.sources(None))
    with pytest.raises(BadURL, match="names neither a device path nor a transport"):
        configuration.sources("lab-m100")


# -- what it says ---------------------------------------------------------------------------------


def said(path: Path, word: str | None) -> dict[str, object]:
    """The values that hold."""
    values: dict[str, object] = {}
    for _, given in reversed(read_configuration(path).sources(word)):
        values |= given
    return values


def test_an_aircraft_comes_before_the_defaults_and_files_stand_beside_it(file: Path) -> None:
    assert said(file, "lab-m100") == {
        "url": "/dev/m100-that-does-not-exist",
        "baud_rate": 921600,
        "firmware": "3.1",
        "level": 1,
        "timeout": 5,
        "app_id": 77,
        "key_file": file.parent / "m100.key",
    }
    assert said(file, None) == said(file, "lab-m100")
    assert said(file, "other")["app_id"] == 78
    assert said(file, "other")["key_file"] == Path("/etc/m100/other.key")


def test_the_defaults_are_those_of_real_aircraft(file: Path) -> None:
    assert said(file, "virtual") == {"url": "sim://?firmware=2.3"}
    assert said(file, "sim://") == {}
    assert said(file, "/dev/ttyUSB0")["app_id"] == 77
    assert "url" not in said(file, "/dev/ttyUSB0")


def test_a_home_folder_is_meant_by_its_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    path = tmp_path / "elsewhere" / "m100link.toml"
    path.parent.mkdir()
    path.write_text('[defaults]\nkey_file = "~/m100.key"\n')
    assert said(path, "/dev/ttyUSB0") == {"key_file": tmp_path / "m100.key"}
    path.write_text("[defaults]\nports = 1\n")
    with pytest.raises(UsageError, match=r"^~/elsewhere/m100link.toml \[defaults\]: there is no"):
        read_configuration(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = \n", "cannot be read: Invalid value (at line 1"),
        ("[defaults]\nfirmwear = '3.1'", "did you mean firmware?"),
        ("[defaults]\nurl = '/dev/ttyUSB0'", "no setting 'url'"),
        ("[aircrafts.a]\nurl = 'sim://'", "did you mean aircraft?"),
        ("url = '/dev/ttyUSB0'", "no table 'url'"),
        ("[aircraft.a]\nbaud = 1", "no url says where it is"),
        ("[aircraft.a]\nurl = 5", "no url says where it is"),
        ("[aircraft]\na = 'sim://'", "[aircraft.a]"),
        ("aircraft = 'a'", "[aircraft.NAME]"),
        ("[aircraft.a]\nurl = 'sim://'\nbaud_rate = 9600", "did you mean baud?"),
        ("[aircraft.a]\nurl = 'sim://'\nbaud = 0", "bits per second"),
        ("[aircraft.a]\nurl = 'sim://'\nbaud = 9600.0", "bits per second"),
        ("[defaults]\nbaud = '9600'", "bits per second"),
        ("[defaults]\ntimeout = 0", "seconds, above 0"),
        ("[defaults]\ntimeout = nan", "seconds, above 0"),
        ("[defaults]\ntimeout = true", "seconds, above 0"),
        ("[defaults]\nfirmware = '9.9'", "one of 1.0, "),
        ("[defaults]\nfirmware = 3.1", "one of 1.0, "),
        ("[defaults]\naircraft = 'b'\n[aircraft.bb]\nurl = 'sim://'", "did you mean bb?"),
        ("[defaults]\naircraft = 'b'", "there are: none"),
        ("[aircraft.'2']\nurl = 'sim://'", "cannot be called '2'"),
        ("[aircraft.'a/b']\nurl = 'sim://'", "cannot be called 'a/b'"),
        ("[aircraft.COM3]\nurl = 'sim://'", "cannot be called 'COM3'"),
        ("[aircraft.position]\nurl = 'sim://'", "a telemetry item is"),
        ("[station]\nprot = 1", "did you mean port?"),
        ("station = 1", "station is no table"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(
    configuration_file: Path, text: str, told: str
) -> None:
    configuration_file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        read_configuration()
    assert told in str(caught.value)
    assert "m100link.toml" in caught.value.seen


@pytest.mark.parametrize("where", ["defaults", "aircraft.a", "station"])
@pytest.mark.parametrize("name", ["key", "token"])
def test_a_secret_is_refused_and_not_repeated(
    configuration_file: Path, where: str, name: str
) -> None:
    configuration_file.write_text(f'[{where}]\nurl = "sim://"\n{name} = "{"ab" * 32}"\n')
    if where != "aircraft.a":
        configuration_file.write_text(f'[{where}]\n{name} = "{"ab" * 32}"\n')
    with pytest.raises(UsageError) as caught:
        read_configuration()
    if (where, name) == ("station", "token") or name == "key":
        assert f"give its path as {name}_file" in str(caught.value)
    assert "abab" not in str(caught.value)


def test_a_file_that_everybody_may_write_is_not_believed(file: Path) -> None:
    file.chmod(0o646)
    with pytest.raises(UsageError, match="chmod o-w"):
        read_configuration()


def test_a_folder_is_not_a_file(configuration_file: Path) -> None:
    configuration_file.mkdir()
    with pytest.raises(UsageError, match="cannot be read"):
        read_configuration()


# -- what uses it ---------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["argument", "option", "environment"])
def test_a_name_is_as_good_as_a_url_for_every_verb(
    cli: CommandLine, file: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    named = {"argument": ["virtual"], "option": ["--url", "virtual"], "environment": []}[by]
    if by == "environment":
        monkeypatch.setenv("M100LINK_URL", "virtual")
    described = cli("info", *named, "--duration", "0.1").objects[0]
    assert (described["url"], described["firmware"]) == ("sim://?firmware=2.3", "2.3")
    assert cli("activate", *named).objects[0]["app_id"] == DEMO_APP_ID
    assert "position.height_m" in cli("echo", *named, "position", "--packages", "1").out
    assert "take off first" in cli("fly", *named, "-2", "0", "1").err


def test_the_aircraft_by_default_is_meant_when_nobody_names_one(
    cli: CommandLine, file: Path
) -> None:
    for arguments in (("info",), ("echo", "position"), ("fly", "2", "0", "1", "--key", "00" * 32)):
        outcome = cli(*arguments)
        assert outcome.status == ExitCode.PORT
        assert "there is no device /dev/m100-that-does-not-exist" in outcome.err


def test_the_key_file_of_an_aircraft_is_used_and_an_option_comes_before_it(
    cli: CommandLine, file: Path, tmp_path: Path
) -> None:
    outcome = cli("takeoff", "lab-m100", "--yes")
    assert outcome.status == ExitCode.USAGE
    assert str(file.parent / "m100.key") in outcome.err
    key = tmp_path / "key"
    key.write_text("ab" * 32)
    key.chmod(0o644)
    assert f"chmod 600 {key}" in cli("takeoff", "lab-m100", "--key-file", str(key)).err
    assert cli("takeoff", "lab-m100", "--key", "ab" * 32).status == ExitCode.PORT


def test_an_aircraft_that_is_not_known_names_those_that_are_near(
    cli: CommandLine, file: Path
) -> None:
    for arguments in (("info", "lab-m10"), ("fly", "lab-m10", "2", "0", "1"), ("serve", "lab-m10")):
        outcome = cli(*arguments)
        assert outcome.status == ExitCode.USAGE
        assert "did you mean lab-m100?" in outcome.err
        assert "\n      /dev/ttyUSB0" in outcome.err
    told = " ".join(cli("info", "quadrocopter").err.split())
    assert "it has lab-m100, virtual, other" in told


def test_a_file_that_is_wrong_stops_every_verb_that_has_an_aircraft(
    cli: CommandLine, configuration_file: Path
) -> None:
    configuration_file.write_text("[defaults]\nkee_file = 'x'\n")
    for verb in ("info", "takeoff", "echo", "config", "serve"):
        outcome = cli(verb, *(["sim://"] if verb != "config" else []))
        assert outcome.status == ExitCode.USAGE
        assert "did you mean key_file?" in outcome.err
    assert cli("decode", "aa").status == ExitCode.OK


def test_serve_knows_the_aircraft_and_its_own_table(cli: CommandLine, file: Path) -> None:
    rows = {
        one["setting"]: [str(one["value"]), one["source"]]
        for one in cli("serve", "lab-m100", "--show-config", "--level", "2").objects
    }
    assert rows["url"] == ["/dev/m100-that-does-not-exist", f"{file} [aircraft.lab-m100]"]
    assert rows["port"] == ["19877", f"{file} [station]"]
    assert rows["pages"] == [str(file.parent / "pages"), f"{file} [station]"]
    assert rows["app_id"] == ["77", f"{file} [defaults]"]
    assert rows["level"] == ["2", "command line"]
    virtual = cli("serve", "--sim", "--show-config").out
    assert "[defaults]" not in virtual
    assert "m100-that-does-not-exist" not in virtual


# -- what a first contact writes into it ----------------------------------------------------------


FOUND: dict[str, Any] = {"acceleration": "raw", "seen": {"on": "2026-11-28", "rc_lost": "zeros"}}


def test_what_was_found_stands_beside_the_name_and_all_else_stays(file: Path) -> None:
    file.chmod(0o640)
    before = file.read_text(encoding="utf-8").splitlines()
    remember(read_configuration(), "lab-m100", "/dev/other", FOUND)
    lines = file.read_text(encoding="utf-8").splitlines()
    at = lines.index("level = 1") + 1
    assert lines[at : at + 2] == [
        'acceleration = "raw"',
        'seen = { on = "2026-11-28", rc_lost = "zeros" }',
    ]
    assert [*lines[:at], *lines[at + 2 :]] == before
    assert file.stat().st_mode & 0o777 == 0o640
    # `connect` of every verb reads the one; the other is for people.
    assert said(file, "lab-m100")["acceleration"] == "raw"
    assert "seen" not in said(file, "lab-m100")
    remember(read_configuration(), "lab-m100", "", {"acceleration": "fused"})
    assert said(file, "lab-m100")["acceleration"] == "fused"
    assert file.read_text(encoding="utf-8").count("acceleration =") == 1


def test_an_aircraft_without_a_name_gets_one(file: Path, configuration_file: Path) -> None:
    remember(read_configuration(), "new", 'tcp://a"b:1', FOUND)
    assert said(file, "new")["url"] == 'tcp://a"b:1'
    assert said(file, "other")["url"] == "tcp://127.0.0.1:1"
    file.unlink()
    remember(read_configuration(), "new", "/dev/ttyUSB0", FOUND)
    assert said(file, "new") == {"url": "/dev/ttyUSB0", "acceleration": "raw"}
    assert file.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    "text",
    [
        'aircraft = { lab = { url = "sim://" } }\n',
        '[aircraft]\nlab.url = "sim://"\n',
        '[aircraft.lab]\nurl = "sim://"\nseen = """\n[aircraft.lab]\n"""\n',
        '[aircraft.lab]\nurl = "sim://"\n"acceleration" = "raw"\n',
        'note = """\n[aircraft.lab]\n"""\n[aircraft.lab]\nurl = "sim://"\n',
    ],
)
def test_a_file_of_another_layout_stays_as_it_is(configuration_file: Path, text: str) -> None:
    configuration_file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="was not changed") as caught:
        remember(Configuration(path=configuration_file, exists=True), "lab", "", FOUND)
    assert 'acceleration = "raw"' in (caught.value.remedy or "")
    assert configuration_file.read_text(encoding="utf-8") == text
    with pytest.raises(UsageError, match="cannot be called"):
        remember(Configuration(path=configuration_file, exists=True), "a b", "", FOUND)


def test_a_shorter_contact_keeps_what_an_earlier_one_found(configuration_file: Path) -> None:
    """Also in a file that a person wrote while the contact went on, with the ends of its lines."""
    before = read_configuration()
    assert not before.exists
    text = '# mine\r\n[aircraft.lab]\r\nurl = "/dev/m100"\r\nseen = { release = "released" }\r\n'
    configuration_file.parent.mkdir(parents=True, exist_ok=True)
    configuration_file.write_bytes(text.encode())
    remember(before, "lab", "/dev/other", FOUND)
    written = configuration_file.read_bytes()
    assert written.startswith(b'# mine\r\n[aircraft.lab]\r\nurl = "/dev/m100"\r\n')
    assert written.count(b"\n") == written.count(b"\r\n")
    assert read_configuration().aircraft["lab"]["seen"] == {
        "release": "released",
        "on": "2026-11-28",
        "rc_lost": "zeros",
    }


def test_a_file_that_may_be_read_only_stays(file: Path) -> None:
    before = file.read_bytes()
    file.chmod(0o444)
    with pytest.raises(UsageError, match="was not changed: it may be read only"):
        remember(read_configuration(), "lab-m100", "", FOUND)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "text",
    ["aircraft = 1\n", '[aircraft.lab]\nurl = "/dev/m100"\nseen = { release = 1979-05-27 }\n'],
)
def test_a_file_of_another_kind_stays(configuration_file: Path, text: str) -> None:
    before = read_configuration()
    configuration_file.parent.mkdir(parents=True, exist_ok=True)
    configuration_file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="was not changed"):
        remember(before, "lab", "", FOUND)
    assert configuration_file.read_text(encoding="utf-8") == text
