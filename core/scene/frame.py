"""The scene frame: the world recentred and scaled in float64, so that float32 is enough afterwards."""

from dataclasses import dataclass

import numpy as np

FLOAT32_ROUNDING = 2.0**-24  # float32 rounds a number by at most this share of it
# In scene units. A camera sees a scene unit in at most some thousand pixels: 0.02 px, which no picture shows.
ROUNDING_ALLOWED = 1e-5


@dataclass(frozen=True)
class SceneFrame:
    """scene = (world - centre) / radius; back again for what is written, and where worlds are compared.

    centre: (3,) float64 in world units. radius: world units per scene unit, > 0.
    """

    centre: np.ndarray
    radius: float

    def to_scene(self, world: np.ndarray) -> np.ndarray:
        """Points (..., 3) in world units -> scene units; the subtraction happens in float64."""
        return (np.asarray(world, dtype=np.float64) - self.centre) / self.radius

    def to_world(self, scene: np.ndarray) -> np.ndarray:
        """Points (..., 3) in scene units -> world units, float64."""
        return np.asarray(scene, dtype=np.float64) * self.radius + self.centre

    @property
    def rounding(self) -> float:
        """By how much float32 moves a coordinate of the scene if it is kept in the world frame; world units."""
        return FLOAT32_ROUNDING * (float(np.abs(self.centre).max()) + self.radius)

    @property
    def file_offset(self) -> np.ndarray:
        """What is subtracted from world coordinates in files of float32, (3,) world units.

        Zeros, so that files lie where the world does; `centre` where the world lies so far from its origin (as
        georeferenced ones do) that float32 would blur the scene.
        """
        return np.zeros(3) if self.rounding <= ROUNDING_ALLOWED * self.radius else self.centre

    def for_files(self) -> "SceneFrame":
        """This frame for writers of float32: as itself, but `file_offset` nearer to the origin."""
        return SceneFrame(self.centre - self.file_offset, self.radius)

    def offset_lines(self) -> list[str]:
        """A line that says by how much files are moved, and why; none where they are not."""
        if not self.file_offset.any():
            return []
        x, y, z = self.file_offset
        why = f"so far from the origin that the float32 of a .ply would move Gaussians by {self.rounding:.2g} units"
        return [f"The scene lies {why}: files are written around ({x:.10g}, {y:.10g}, {z:.10g})."]

    def to_json(self) -> dict:
        return {"centre": [float(x) for x in self.centre], "radius": float(self.radius)}

    @staticmethod
    def from_json(values: dict) -> "SceneFrame":
        """The inverse of `to_json`; raises KeyError, TypeError, ValueError or OverflowError for what is no frame."""
        centre, radius = np.asarray(values["centre"], dtype=np.float64).reshape(3), float(values["radius"])
        if not (np.isfinite(centre).all() and 0 < radius < np.inf):
            raise ValueError(f"no frame: centre {values['centre']}, radius {values['radius']}")
        return SceneFrame(centre, radius)

    @staticmethod
    def around(points: np.ndarray, quantile: float = 0.97) -> "SceneFrame":
        """The frame in which `quantile` of the (P, 3) world points lie within radius 1 of their median."""
        points = np.asarray(points, dtype=np.float64)
        centre = np.median(points, axis=0)
        radius = float(np.quantile(np.linalg.norm(points - centre, axis=1), quantile))
        return SceneFrame(centre, radius if radius > 0 else 1.0)
