"""ROS launch files of DJI's node, read as they are.

The file may come from anywhere, so it is read with nothing but the tokenizer: no document type, no
entities, a size limit.
"""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from m100link.errors import UsageError
from m100link.errors.texts import read_path

__all__ = ["LAUNCH_NAMES", "read_launch"]

LAUNCH_NAMES = {
    "serial_name": "url",
    "baud_rate": "baud_rate",
    "app_id": "app_id",
    "app_api_level": "level",
    "app_version": "app_version",
    "app_bundle_id": "bundle_id",
    "enc_key": "key",
}
"""Parameter of DJI's node, and what it is called here."""

_MAX_SIZE = 256 * 1024
_INTEGERS = ("baud_rate", "app_id", "level", "app_version")


def read_launch(path: Path) -> tuple[dict[str, str | int], list[str]]:
    """The parameters of DJI's node in a launch file, and the names of those without a use here.

    Raises:
        UsageError: The file cannot be read, is not XML, has a document type or a value that needs
            roslaunch to be understood.
    """
    try:
        text = read_path(path).read_bytes()
    except OSError as error:
        raise UsageError(
            f"the launch file cannot be read: {path}: {error.strerror}",
            remedy="check the path, and who may read it",
        ) from error
    if len(text) > _MAX_SIZE:
        raise UsageError(f"{path} has {len(text)} bytes: that is not a launch file")
    found = _parameters(text, path)
    used = {
        LAUNCH_NAMES[name]: _value(LAUNCH_NAMES[name], value, path)
        for name, value in found.items()
        if name in LAUNCH_NAMES
    }
    return used, [name for name in found if name not in LAUNCH_NAMES]


def _parameters(text: bytes, path: Path) -> dict[str, str]:
    found: dict[str, str] = {}

    def element(name: str, attributes: dict[str, str]) -> None:
        if name == "param" and "name" in attributes and "value" in attributes:
            found[attributes["name"].rpartition("/")[2]] = attributes["value"]

    def refuse(*_: object) -> None:
        raise UsageError(
            f"{path} has a document type or entities",
            cause="launch files have none; files made to harm a reader do",
        )

    parser = expat.ParserCreate()
    parser.StartElementHandler = element
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        hint = ""
        if b"<!-- your" in text:
            hint = "replace the places like <!-- your appid --> by your own values"
        raise UsageError(f"{path} is not XML: {error}", remedy=hint) from error
    return found


def _value(name: str, value: str, path: Path) -> str | int:
    if "$(" in value:
        raise UsageError(
            f"{path}: {name} is {value!r}, which only roslaunch understands",
            remedy="write the value itself there, or give it by flag or environment",
        )
    if name not in _INTEGERS:
        return value
    try:
        return int(value, 0)
    except ValueError:
        raise UsageError(f"{path}: {name} is {value!r}, which is not a number") from None
