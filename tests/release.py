"""Makes a release and looks into it: ``nox -s build``, or ``python -m tests.release --to FOLDER``.

Wheel and source archive are built twice and must be the same bit by bit. Beside them stand the bill
of materials (CycloneDX), what an installation with all extras consists of in the tested versions,
and SHA256SUMS, which the signed tag of a release carries.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = {
    "LICENSE",
    "README.md",
    "COMMIT",
    "noxfile.py",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
}
"""What the source archive has beside the programs."""
MANUAL = {"m100link/manual/explanation/safety.md", "m100link/manual/COMMIT"}
"""What `m100link docs` and `m100link --version` read, of what a wheel has."""
INSTALLED = {"anyio", "cryptography", "pyserial-asyncio"}
"""What every installation has."""


def run(*command: str | Path, **env: str) -> None:
    """Run a program; one that fails ends this one."""
    subprocess.run(command, env=os.environ | env, cwd=ROOT, check=True)


def built(output: Path) -> tuple[Path, Path]:
    """Wheel and source archive, made afresh in a folder."""
    for old in output.glob("m100link-*"):
        old.unlink()
    asked = ("git", "log", "-1", "--format=%ct")
    told = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    made_at = os.environ.get("SOURCE_DATE_EPOCH", told.strip() or "1700000000")
    build = (sys.executable, "-m", "build", "--no-isolation", "--outdir", output)
    run(*build, SOURCE_DATE_EPOCH=made_at)
    (wheel,) = output.glob("*.whl")
    (archive,) = output.glob("*.tar.gz")
    return wheel, archive


def bill_of_materials(wheel: Path) -> list[str]:
    """Write what an installation of the wheel with all extras consists of: the names of it."""
    pyproject = ROOT / "pyproject.toml"
    extras = tomllib.loads(pyproject.read_text("utf-8"))["project"]["optional-dependencies"]
    place = wheel.parent / "installed"
    run(sys.executable, "-m", "venv", "--clear", "--without-pip", place)
    python = place / "bin" / "python"
    pip = (sys.executable, "-m", "pip", "--quiet", "--python", python)
    lock = (ROOT / "requirements-dev.txt").read_text("utf-8")
    tested = place / "constraints.txt"  # without checksums, which pip wants of all or of none
    tested.write_text(re.sub(r" \\$|\n    --hash=\S+", "", lock, flags=re.MULTILINE), "utf-8")
    run(*pip, "install", "--constraint", tested, f"{wheel}[{','.join(extras)}]")
    bill = wheel.with_suffix(".cdx.json")
    told = ("--output-reproducible", "--output-format", "JSON", "--output-file", bill)
    run(
        sys.executable, "-m", "cyclonedx_py", "environment", python, "--pyproject", pyproject, *told
    )
    shutil.rmtree(place)
    return [one["name"].lower() for one in json.loads(bill.read_text("utf-8"))["components"]]


def complaints(in_wheel: list[str], in_archive: list[str], components: list[str]) -> list[str]:
    """What is wrong with a release, by the names of what is in it."""
    strangers = [n for n in in_wheel if not re.match(r"m100link(-[^/]+\.dist-info)?/", n)]
    missing = PAGES - set(in_archive)
    found = {
        "the wheel has no py.typed": "m100link/py.typed" not in in_wheel,
        f"the wheel holds more than the package: {strangers}": strangers,
        f"the wheel lacks {MANUAL - set(in_wheel)}": MANUAL - set(in_wheel),
        f"the source archive lacks {missing}": missing,
        f"the bill of materials lacks {INSTALLED - set(components)}": INSTALLED - set(components),
    }
    return [text for text, is_so in found.items() if is_so]


def main() -> str | None:
    """Make it; what is wrong with it."""
    parser = argparse.ArgumentParser(prog="nox -s build --", description=__doc__)
    parser.add_argument("--to", type=Path, default=ROOT / "dist", help="folder, default: dist")
    output = parser.parse_args().to.resolve()
    wheel, archive = built(output)
    with tempfile.TemporaryDirectory() as again:
        for first, second in zip((wheel, archive), built(Path(again)), strict=True):
            if first.read_bytes() != second.read_bytes():
                return f"{first.name} was another one when it was built again"
    components = bill_of_materials(wheel)
    made = sorted(output.glob("m100link-*"))
    sums = [f"{hashlib.sha256(one.read_bytes()).hexdigest()}  {one.name}\n" for one in made]
    (output / "SHA256SUMS").write_text("".join(sums), encoding="ascii")
    with zipfile.ZipFile(wheel) as packed:
        in_wheel = packed.namelist()
    with tarfile.open(archive) as tarred:
        in_archive = [name.partition("/")[2] for name in tarred.getnames()]
    counts = f"{len(in_wheel)} files; {archive.name}: {len(in_archive)} entries"
    sys.stdout.write(f"{wheel.name}: {counts}; {len(components)} components\n")
    return "\n".join(complaints(in_wheel, in_archive, components)) or None


if __name__ == "__main__":
    sys.exit(main())
