"""Known vulnerabilities of what is installed here, by pip-audit: ``nox -s audit``."""

from __future__ import annotations

import json
import subprocess
import sys


def found(report: str) -> tuple[int, list[str]]:
    """How many packages were audited, and their vulnerabilities.

    Of a package that its database does not answer for pip-audit says so and ends with 0 all the
    same: such a package was not audited.
    """
    try:
        packages = json.loads(report)["dependencies"]
    except ValueError:
        packages = []
    audited = [package for package in packages if "vulns" in package]
    if not any(package["name"] == "cryptography" for package in audited):
        return 0, []
    return len(audited), [
        f"{package['name']} {package['version']}: {one['id']}"
        for package in audited
        for one in package["vulns"]
    ]


def main() -> str | None:
    """Ask; the vulnerabilities."""
    asked = ("pip_audit", "--local", "--skip-editable", "--progress-spinner", "off", "-f", "json")
    command = (sys.executable, "-m", *asked, *sys.argv[1:])
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    audited, vulnerabilities = found(done.stdout)
    if not audited:
        why = f"the database of vulnerabilities cannot be reached here\n{done.stderr}"
        sys.stdout.write(f"nothing was audited: {why}\n")
        return None
    sys.stdout.write(f"{audited} packages audited\n")
    return "\n".join(vulnerabilities) or None


if __name__ == "__main__":
    sys.exit(main())
