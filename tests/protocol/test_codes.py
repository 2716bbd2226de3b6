"""Ack codes: the document's numbers, system codes in any place, unknown ones kept."""

from __future__ import annotations

import pickle

import pytest

from m100link.protocol.codes import (
    AckCode,
    ActivationCode,
    ArmCode,
    AuthorityCode,
    MobileDataCode,
    RatesCode,
    SystemCode,
    TaskResultCode,
    TaskStartCode,
    VersionCode,
)

NUMBERS: dict[type[AckCode], set[int]] = {
    SystemCode: {0xFF00, 0xFF01, 0xFF02},
    VersionCode: {0},
    ActivationCode: {0, 1, 2, 3, 4, 5, 6, 7, 8},
    MobileDataCode: {0},
    RatesCode: {0, 1},
    AuthorityCode: {0, 1, 2, 3, 4, 0xC9},
    TaskStartCode: {1, 2},
    TaskResultCode: {1, 3, 4, 5},
    ArmCode: {0, 1, 2, 3},
}
ENUMS = sorted(NUMBERS, key=lambda enum: enum.__name__)
OTHERS = [enum for enum in ENUMS if enum is not SystemCode]


@pytest.mark.parametrize("enum", ENUMS)
def test_each_enum_has_the_numbers_of_the_sources(enum: type[AckCode]) -> None:
    assert {int(code) for code in enum} == NUMBERS[enum]
    for code in enum:
        assert code.is_known
        assert code.meaning
        assert enum(int(code)) is code


@pytest.mark.parametrize("enum", OTHERS)
@pytest.mark.parametrize("system", list(SystemCode))
def test_a_system_code_can_stand_in_the_place_of_any_code(
    enum: type[AckCode], system: SystemCode
) -> None:
    code = enum(int(system))
    assert isinstance(code, enum)
    assert code == system
    assert (code.name, code.meaning, code.remedy) == (system.name, system.meaning, system.remedy)
    assert code.is_system
    assert code.is_known


@pytest.mark.parametrize("enum", ENUMS)
@pytest.mark.parametrize("number", [0x4D, 0xFF7F, 0xFFFF])
def test_an_unknown_code_keeps_its_number(enum: type[AckCode], number: int) -> None:
    code = enum(number)
    assert isinstance(code, enum)
    assert code == number
    assert not code.is_known
    assert f"0x{number:04X}" in code.meaning
    assert f"{number:04X}" in code.name
    assert code.is_system == (number >> 8 == 0xFF)


def test_unknown_codes_of_one_number_are_equal_and_no_members() -> None:
    assert ActivationCode(77) == ActivationCode(77)
    assert len({ActivationCode(77), ActivationCode(77)}) == 1
    assert 77 not in list(ActivationCode)


@pytest.mark.parametrize("number", [-1, 0x10000])
def test_what_two_bytes_cannot_carry_is_no_code(number: int) -> None:
    with pytest.raises(ValueError, match=str(number)):
        ActivationCode(number)


@pytest.mark.parametrize("number", [0, 77, 0xFF01])
def test_codes_survive_pickling(number: int) -> None:
    again = pickle.loads(pickle.dumps(ActivationCode(number)))
    assert again == ActivationCode(number)
    assert again.meaning == ActivationCode(number).meaning


def test_every_refusal_says_what_to_do() -> None:
    fine = {"SUCCESS", "ACTIVATED", "RELEASED", "OBTAINED", "RELEASING", "STARTED", "EXECUTING"}
    fine |= {"SUCCEEDED", "DONE", "ALREADY", "NOT_CURRENT"}
    silent = [
        str(code)
        for enum in ENUMS
        for code in enum
        if code.name not in fine and not (code.remedy or enum is RatesCode)
    ]
    assert silent == []


def test_a_code_that_nobody_lists_says_what_can_be_behind_it_and_asks_for_a_report() -> None:
    unknown = ActivationCode(0x7FED)
    assert "0x7FED" in unknown.meaning
    assert "firmware" in unknown.cause
    assert "report" in unknown.remedy
