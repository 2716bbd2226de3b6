"""What the example by MAVSDK uses; the package is too large to be installed for its types."""

from typing import Any

def __getattr__(name: str) -> Any: ...
