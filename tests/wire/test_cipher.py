"""Keys stay secret; blocks are DJI's AES-256 ECB."""

from __future__ import annotations

import copy
import logging
import pickle
import traceback

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m100link.errors import BadKey, M100Error, UsageError
from m100link.wire import Cipher, Key, encode_frame
from tests.support import KEY

SECRET = bytes.fromhex("c0ffee" + "5a" * 28 + "99")


def _shows(text: str) -> bool:
    """Whether any form of the secret, or a good part of it, can be read in a text."""
    forms = (SECRET.hex(), SECRET.hex().upper(), repr(SECRET)[2:-1], "5a5a5a5a", "ZZZZ")
    return any(form in text for form in forms)


def test_the_search_for_the_secret_finds_it_where_it_is() -> None:
    assert _shows(SECRET.hex())
    assert _shows(repr(SECRET))
    assert _shows(str([SECRET]))


def test_bytes_hex_and_key_make_equal_keys() -> None:
    keys = {Key(KEY), Key(bytearray(KEY)), Key(KEY.hex()), Key(KEY.hex().upper()), Key(Key(KEY))}
    assert keys == {Key(f"  {KEY.hex()}\n")}
    assert Key(KEY).reveal() == KEY


def test_different_keys_differ_and_a_key_is_not_its_bytes() -> None:
    assert Key(KEY) != Key(SECRET)
    assert Key(KEY) != KEY


@pytest.mark.parametrize("size", [0, 1, 16, 24, 31, 33, 64])
def test_a_key_of_another_length_names_the_length_it_has(size: int) -> None:
    with pytest.raises(BadKey, match=f"{size} bytes"):
        Key(bytes(size))
    if size != 64:
        with pytest.raises(BadKey, match=f"{size} characters"):
            Key("0" * size)


@pytest.mark.parametrize(
    "text",
    [
        *("g" * 64, "5a " * 21 + "5", " ".join(["5a"] * 21) + " 5", "٠" * 64, "0x" + "5a" * 31),
        "5a" * 15 + "  " + "5a" * 16,  # whole bytes, as `fromhex` reads them, and one too few
    ],
)
def test_text_that_is_not_64_hex_digits_is_refused(text: str) -> None:
    with pytest.raises(BadKey):
        Key(text)


def test_what_is_neither_bytes_nor_text_is_refused() -> None:
    with pytest.raises(BadKey, match="int"):
        Key(12345)  # type: ignore[arg-type]


def test_a_bad_key_is_a_usage_error_and_a_value_error() -> None:
    with pytest.raises(UsageError):
        Key(b"short")
    with pytest.raises(ValueError, match="5 bytes"):
        Key(b"short")


def test_the_key_shows_itself_in_no_text() -> None:
    key = Key(SECRET)
    cipher = Cipher(key)
    for thing in (key, cipher, [key], {"key": key}):
        assert not _shows(f"{thing!r} {thing!s} {thing}")
    assert "redacted" in repr(key)


@pytest.mark.parametrize(
    "wrong", [SECRET[:-1], SECRET + b"Z", SECRET.hex()[:-1], SECRET.hex()[:-1] + "g"]
)
def test_a_refused_key_is_not_in_its_error(wrong: bytes | str) -> None:
    with pytest.raises(M100Error) as caught:
        Key(wrong)
    error: BaseException | None = caught.value
    while error is not None:
        assert not _shows(f"{error} {error!r} {error.args} {vars(error)}")
        error = error.__cause__ or error.__context__
    assert not _shows("".join(traceback.format_exception(caught.value)))


def test_neither_key_nor_cipher_can_be_pickled_or_copied_into_bytes() -> None:
    for thing in (Key(SECRET), Cipher(SECRET)):
        with pytest.raises(TypeError):
            pickle.dumps(thing)
        with pytest.raises(TypeError):
            copy.deepcopy(thing)


def test_the_key_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    cipher = Cipher(SECRET)
    logging.getLogger("m100link").info("%s %r", cipher, cipher.key)
    encode_frame(b"data", session=0, sequence=0, cipher=cipher)
    assert not _shows(caplog.text)


def test_a_known_block_encrypts_as_fips_197_says() -> None:
    # FIPS 197, appendix C.3: AES-256 of 00112233… under 000102….
    plain = bytes.fromhex("00112233445566778899aabbccddeeff")
    ciphertext, padding = Cipher(KEY).encrypt(plain)
    assert ciphertext[:16].hex() == "8ea2b7ca516745bfeafc49904b496089"
    assert (len(ciphertext), padding) == (32, 16)


@given(st.binary(max_size=100))
def test_padding_fills_one_to_sixteen_bytes_and_comes_off_again(data: bytes) -> None:
    cipher = Cipher(KEY)
    ciphertext, padding = cipher.encrypt(data)
    assert 1 <= padding <= 16
    assert len(ciphertext) == len(data) + padding
    assert len(ciphertext) % 16 == 0
    assert cipher.decrypt(ciphertext) == data + bytes(padding)


def test_no_state_passes_from_one_message_to_the_next() -> None:
    used, block = Cipher(KEY), b"same block twice"
    first = used.encrypt(block)
    used.decrypt(bytes(48))
    assert used.encrypt(block) == first == Cipher(KEY).encrypt(block)


def test_a_tail_shorter_than_a_block_is_left_as_it_is() -> None:
    cipher = Cipher(KEY)
    ciphertext, _ = cipher.encrypt(b"sixteen bytes ok")
    assert cipher.decrypt(ciphertext[:16] + b"tail") == b"sixteen bytes ok" + b"tail"
    assert cipher.decrypt(b"tail") == b"tail"


def test_random_padding_hides_that_two_commands_are_equal() -> None:
    cipher = Cipher(KEY, random_padding=True)
    texts = {cipher.encrypt(b"\x01\x00\x01")[0] for _ in range(20)}
    assert len(texts) == 20
    assert {cipher.decrypt(text)[:3] for text in texts} == {b"\x01\x00\x01"}


@pytest.mark.parametrize("digits", [63, 65, 66])
def test_a_key_with_too_few_or_too_many_digits_names_both_numbers(digits: int) -> None:
    with pytest.raises(BadKey, match=f"has {digits} characters, 64 hex digits are needed"):
        Key("a" * digits)


def test_spaces_in_a_key_of_the_right_length_are_refused() -> None:
    """bytes.fromhex forgives them, and would give a key that is too short."""
    with pytest.raises(BadKey, match="hex digit"):
        Key("aa " * 21 + "a")


def test_a_cipher_tells_its_key_to_who_compares() -> None:
    assert Cipher(KEY).key == Key(KEY)
