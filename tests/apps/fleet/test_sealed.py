"""A word that was changed or is gone is noticed, whatever became of it."""

from __future__ import annotations

import pytest

from m100link.apps.fleet.order_log import Mark, seal, words

LINES = [seal(number, 7, {"id": f"{number}"}) for number in (7, 8, 9)]
MARK = bytes(Mark(9, 7))


def test_what_was_written_is_read() -> None:
    read = words("".join(LINES).encode(), MARK)
    assert read.kept == {number: {"id": f"{number}"} for number in (7, 8, 9)}
    assert (read.damaged, read.sure_from, read.newest) == (0, 0, 9)


@pytest.mark.parametrize("bit", range(8))
def test_no_bit_of_file_or_mark_turns_over_unnoticed(bit: int) -> None:
    whole = "".join(LINES).encode()
    for at in range(len(whole)):
        data = whole[:at] + bytes((whole[at] ^ 1 << bit,)) + whole[at + 1 :]
        read = words(data, MARK)
        assert read.damaged, (at, bit)
        assert all(read.kept[number] == {"id": f"{number}"} for number in read.kept)
    for at in range(len(MARK)):
        mark = MARK[:at] + bytes((MARK[at] ^ 1 << bit,)) + MARK[at + 1 :]
        assert words(whole, mark).damaged == 1


@pytest.mark.parametrize(
    ("kept", "mark", "damaged", "sure_from"),
    [
        ([], MARK, 3, 10),
        ([8, 9], MARK, 1, 8),
        ([7, 9], MARK, 1, 9),
        ([7, 8], MARK, 1, 10),
        ([9, 7, 8], MARK, 0, 0),  # sectors that changed places say the same
        ([7, 8, 9], bytes(Mark(8, 7)), 0, 0),  # the power went before the mark was on the disk
        ([7, 8, 9], bytes(Mark(6, 1)), 0, 0),  # or just after the file was written anew
        ([7, 8, 9], b"", 1, 10),
        ([], b"", 0, 0),
        ([], bytes(Mark(0, 0)), 0, 0),
    ],
)
def test_what_is_gone_is_counted(
    kept: list[int], mark: bytes, damaged: int, sure_from: int
) -> None:
    read = words("".join(LINES[number - 7] for number in kept).encode(), mark)
    assert (read.damaged, read.sure_from) == (damaged, sure_from)


def test_a_mark_is_as_long_whatever_it_says() -> None:
    assert {len(bytes(Mark(newest, 1))) for newest in (0, 9, 10**9, 10**17)} == {len(MARK)}
    assert Mark.read(MARK) == Mark(9, 7)
