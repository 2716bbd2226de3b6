"""Sphinx configuration. `nox -s docs` builds with every warning an error."""

from __future__ import annotations

import gc
import sys
import tomllib
from pathlib import Path

gc.disable()  # to look for garbage took a fifth; so it has 0.5 GB at most, instead of 0.3

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "_ext"))
sys.path.append(str(DOCS.parent))  # benchmarks; the package is the installed one, if there is one
metadata = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = metadata["name"]
author = metadata["authors"][0]["name"]
copyright = f"2026, {author}"
version = release = metadata["version"]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx.ext.napoleon",
    "pictures",
    "public_names",
    "tables",
    "command_tables",
    "mavlink_tables",
    "ros2_tables",
    "error_list",
    "figures",
]
exclude_patterns = ["_build"]
# `Frame` is two things: m100link.Frame (ground or body) and m100link.wire.Frame (bytes). A bare
# name means the first of them.
suppress_warnings = ["ref.python"]

myst_enable_extensions = ["colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # attributes are described by their class, not indexed one by one
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88

# Sphinx checks references against this manual alone, without a network. Names that belong to
# other projects therefore stand here without a link.
nitpicky = True
nitpick_ignore_regex = [
    # The standard library and the packages that m100link stands on.
    (
        r"py:.*",
        r"(asyncio|collections|contextlib|dataclasses|datetime|enum|pathlib|struct|typing)(\..*)?",
    ),
    (r"py:class", r"os\.PathLike"),
    (r"py:.*", r"(anyio|cryptography|serial|serial_asyncio)(\..*)?"),
    (r"py:class", r"(Path|(random\.)?Random)"),
    # How slow a line is, from the session that measures it.
    (r"py:class", r"m100link\.session\.events\.Latency"),
    # The signed order is handed on as it is.
    (r"py:class", r"m100link\.apps\.fleet\.payloads\.OrderMessage"),
    # Attributes are described by their class, they are not entries of their own.
    (r"py:attr", r"state"),
    # Programs get a Control or a Subscription from the aircraft and never make one.
    (r"py:class", r"m100link\.flight\.(tasks\.Commander|guidance\.Flyer|lifecycle\.BlockClaim)"),
    (r"py:class", r"(Requests|TelemetryStream|m100link\.flight\.tasks\.SettingsPace)"),
    (r"py:class", r"m100link\.sync\.portal\.(Portal|Caller)"),
    (
        r"py:class",
        r"m100link\.flight\.missions\.\w+\.Mission(Context|Guard|Session)",
    ),
    (r"py:class", r"m100link\.(flight\.guards\.GuardKeeper|telemetry\.subscription\.SampleQueue)"),
    # Type variables.
    (r"py:class", r"m100link\.[\w.]+\.[RT]"),
    # A default factory makes a signature that Sphinx cannot parse; it guesses at the pieces.
    (r"py:class", r"(dict\[str|tuple\[(int|str))"),
]

doctest_global_setup = "import m100link"
doctest_default_flags = 0

html_theme = "furo"
html_title = f"m100link {release}"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_copy_source = False
html_show_sphinx = False
