"""Frames and bytes: no I/O, no clock, no asyncio."""

from m100link.wire.cipher import Cipher, Key
from m100link.wire.frame import MAX_DATA_SIZE, Discard, Frame, FrameDecoder, encode_frame

__all__ = ["MAX_DATA_SIZE", "Cipher", "Discard", "Frame", "FrameDecoder", "Key", "encode_frame"]
