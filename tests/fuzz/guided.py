"""The same readers, by an engine that keeps the inputs which take new paths: atheris.

Run by `nox -s fuzz -- --engine atheris`, a process for each target: the engine ends the one that it
runs in, and has to see m100link while that is imported.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

__all__ = ["main", "quoted"]


def quoted(tokens: Iterable[bytes]) -> str:
    """Tokens as libFuzzer's dictionary has them."""
    lines = ("".join(f"\\x{byte:02x}" for byte in token) for token in tokens if token)
    return "".join(f'"{line}"\n' for line in lines)


def main() -> None:
    """Read mutated inputs of one target for so many seconds; 77 when one raises, as libFuzzer."""
    name, seconds, seed = sys.argv[1:]
    engine = importlib.import_module("atheris")  # of no dependency group: it has few wheels
    with engine.instrument_imports(include=["m100link"]):
        from tests.fuzz.targets import TARGETS
    target = TARGETS[name]

    def read(data: bytes) -> None:
        with suppress(*target.refuses):
            target.read(data)

    with tempfile.TemporaryDirectory() as folder:
        corpus, words = Path(folder, "corpus"), Path(folder, "words")
        corpus.mkdir()
        for number, one in enumerate(target.seeds()):
            (corpus / str(number)).write_bytes(one)
            read(one)  # what is imported when it is first used is seen, too
        options = [f"-max_total_time={seconds}", f"-seed={seed}"]
        if target.tokens:  # an empty dictionary is refused
            words.write_text(quoted(target.tokens), "ascii")
            options.append(f"-dict={words}")
        limits = ["-max_len=4096", "-timeout=10", "-rss_limit_mb=2048", "-print_final_stats=1"]
        engine.Setup([sys.argv[0], str(corpus), *options, *limits], read)
        engine.Fuzz()


if __name__ == "__main__":
    main()
