"""The AES key and the block cipher of frame data.

AES-256 in ECB mode, each 16-byte block by itself (errata 35, 36). That is DJI's format, not a
recommendation: equal blocks encrypt equally and nothing authenticates a frame.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

from m100link.errors import BadKey

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers import CipherContext

BLOCK_SIZE = 16
KEY_SIZE = 32


class Key:
    """An AES-256 key: 32 bytes, or the 64 hex digits that DJI's site hands out.

    The key shows itself nowhere: not in ``repr``, ``str``, errors or pickles. Code that must have
    the bytes calls :meth:`reveal`.

    Args:
        value: 32 bytes, 64 hex digits (upper or lower case, surrounding white space ignored), or
            another key.

    Raises:
        BadKey: Any other value. The message says what was wrong without quoting the value.
    """

    __slots__ = ("_value",)

    def __init__(self, value: bytes | bytearray | str | Key) -> None:
        if isinstance(value, Key):
            self._value: bytes = value.reveal()
        elif isinstance(value, str):
            self._value = _from_hex(value.strip())
        elif isinstance(value, bytes | bytearray):
            if len(value) != KEY_SIZE:
                raise BadKey(
                    f"the key has {len(value)} bytes, AES-256 needs {KEY_SIZE}",
                    cause="a key that was cut, or 64 hex digits passed as bytes",
                    remedy="pass 32 bytes, or the 64 hex digits as a string",
                )
            self._value = bytes(value)
        else:
            raise BadKey(
                f"a key cannot be made of {type(value).__name__}",
                remedy="pass 32 bytes, or the 64 hex digits as a string",
            )

    def reveal(self) -> bytes:
        """The 32 bytes of the key."""
        return self._value

    def __eq__(self, other: object) -> bool:
        return self._value == other.reveal() if isinstance(other, Key) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._value)

    def __repr__(self) -> str:
        return "Key(<redacted>)"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a key is not pickled: it would be readable in the file")


def _from_hex(text: str) -> bytes:
    if len(text) != 2 * KEY_SIZE:
        raise BadKey(
            f"the key has {len(text)} characters, {2 * KEY_SIZE} hex digits are needed",
            cause="a key that was cut when it was copied, or an app id in its place",
            remedy="copy the enc key of your app again: 64 digits, 0-9 and a-f",
        )
    try:
        value = bytes.fromhex(text)
    except ValueError:
        value = b""
    if len(value) != KEY_SIZE:  # fromhex forgives spaces between bytes, a key has none
        # The ValueError is not chained: its message may quote the key.
        raise BadKey(
            "the key has a character that is not a hex digit",
            remedy="copy the enc key of your app again: 64 digits, 0-9 and a-f",
        ) from None
    return value


class Cipher:
    """Encrypts and decrypts frame data with one key.

    One long-lived ECB context per direction: in ECB no state passes from block to block, and
    setting a context up costs several times the encryption of a frame.

    Args:
        key: The key, in any form that :class:`Key` takes.
        random_padding: Fill the padding with random bytes (as good as any: receivers ignore it,
            and it keeps equal commands from looking equal). Off, padding is zero, as in the
            golden vectors.

    Attributes:
        decrypt_blocks: Decrypts whole blocks, all that DJI's senders send.
    """

    __slots__ = ("_encryptor", "_key", "_random_padding", "decrypt_blocks")

    def __init__(self, key: bytes | str | Key, *, random_padding: bool = False) -> None:
        # Loaded here because most links start plain and the import costs more than all the rest.
        from cryptography.hazmat.primitives.ciphers import Cipher as BlockCipher
        from cryptography.hazmat.primitives.ciphers import algorithms, modes

        self._key = Key(key)
        self._random_padding = random_padding
        block_cipher = BlockCipher(algorithms.AES(self._key.reveal()), modes.ECB())
        self._encryptor: CipherContext = block_cipher.encryptor()
        self.decrypt_blocks: Callable[[bytes], bytes] = block_cipher.decryptor().update

    @property
    def key(self) -> Key:
        """The key in use."""
        return self._key

    def encrypt(self, data: bytes) -> tuple[bytes, int]:
        """Pad and encrypt; returns the ciphertext and the number of padding bytes, 1 to 16."""
        padding = BLOCK_SIZE - len(data) % BLOCK_SIZE
        pad_bytes = os.urandom(padding) if self._random_padding else bytes(padding)
        return self._encryptor.update(data + pad_bytes), padding

    def decrypt(self, data: bytes) -> bytes:
        """Decrypt whole blocks; a shorter tail is left as it is, like DJI's codec does."""
        tail = len(data) % BLOCK_SIZE
        if tail:
            return self.decrypt_blocks(data[:-tail]) + data[-tail:]
        return self.decrypt_blocks(data)

    def __repr__(self) -> str:
        return f"Cipher({self._key!r})"
