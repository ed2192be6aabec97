"""The scene frame: the world recentred and scaled in float64, so that float32 is enough afterwards."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SceneFrame:
    """scene = (world - centre) / radius. The inverse is applied once, at export.

    centre: (3,) float64 in world units. radius: world units a scene unit, > 0.
    """

    centre: np.ndarray
    radius: float

    def to_scene(self, world: np.ndarray) -> np.ndarray:
        """Points (..., 3) in world units -> scene units; the subtraction happens in float64."""
        return (np.asarray(world, dtype=np.float64) - self.centre) / self.radius

    def to_world(self, scene: np.ndarray) -> np.ndarray:
        """Points (..., 3) in scene units -> world units, float64."""
        return np.asarray(scene, dtype=np.float64) * self.radius + self.centre

    def to_json(self) -> dict:
        return {"centre": [float(x) for x in self.centre], "radius": float(self.radius)}

    @staticmethod
    def from_json(values: dict) -> "SceneFrame":
        return SceneFrame(np.asarray(values["centre"], dtype=np.float64), float(values["radius"]))

    @staticmethod
    def around(points: np.ndarray, quantile: float = 0.97) -> "SceneFrame":
        """The frame in which `quantile` of the (P, 3) world points lie within radius 1 of their median."""
        points = np.asarray(points, dtype=np.float64)
        centre = np.median(points, axis=0)
        radius = float(np.quantile(np.linalg.norm(points - centre, axis=1), quantile))
        return SceneFrame(centre, radius if radius > 0 else 1.0)
