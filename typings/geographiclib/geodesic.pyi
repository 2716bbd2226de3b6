from typing import ClassVar

class Geodesic:
    WGS84: ClassVar[Geodesic]
    def Inverse(self, lat1: float, lon1: float, lat2: float, lon2: float) -> dict[str, float]: ...
