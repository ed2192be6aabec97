"""The Gaussians while they learn: parameters, Adam moments and the statistics that density control needs."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from core.config import Settings
from core.data.collection import Collection, astray
from core.scene.harmonics import coefficient_count, dc_of_colour
from core.scene.splats import Splats
from core.training.adam import Moved, adam_rows

INITIAL_OPACITY = 0.1  # 3DGS
REST_BAND_SHARE = 1 / 20  # 3DGS: bands above DC learn twenty times slower
LONE_SPACING = 0.1  # scene units: of a point without another
LEAST_SCALE = 1e-5  # scene units: of points that coincide
SKY_OPACITY = 0.99
SKY_MARGIN = 4.0  # the dome is at least so many times as far off as the farthest camera
SKY_FLATNESS = 0.01  # thickness of a dome Gaussian over its width
MOMENTS = ("first", "second")


@dataclass
class Gaussians:
    """N Gaussians and the `sky` last rows among them: the dome, whose geometry is fixed and never densified.

    parameters: the tensors of Splats and, if wanted, `latents` (N, L). first, second: Adam moments of the same shapes.
    counts: (N,) int32 Adam steps. gradient_sum, seen: (N,) what density control gathers between two rounds.
    """

    parameters: dict[str, Tensor]
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    counts: Tensor
    gradient_sum: Tensor
    seen: Tensor
    sky: int

    @staticmethod
    def of(parameters: dict[str, Tensor], sky: int) -> "Gaussians":
        """Fresh moments and statistics around these parameters."""
        rows = len(parameters["means"])
        return Gaussians(
            parameters={name: tensor.contiguous() for name, tensor in parameters.items()},
            first={name: torch.zeros_like(tensor) for name, tensor in parameters.items()},
            second={name: torch.zeros_like(tensor) for name, tensor in parameters.items()},
            counts=torch.zeros(rows, dtype=torch.int32),
            gradient_sum=torch.zeros(rows),
            seen=torch.zeros(rows),
            sky=sky,
        )

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def solid(self) -> int:
        """The number of Gaussians that are not sky."""
        return len(self) - self.sky

    @property
    def splats(self) -> Splats:
        """The base Gaussians, sharing memory with the parameters."""
        return Splats(**{name: tensor for name, tensor in self.parameters.items() if name != "latents"})

    @property
    def latents(self) -> Tensor | None:
        return self.parameters.get("latents")

    def to(self, device: torch.device) -> "Gaussians":
        """The same Gaussians on `device`."""
        return Gaussians.from_tensors({name: tensor.to(device) for name, tensor in self.tensors().items()}, self.sky)

    def leaves(self, rows: Tensor) -> dict[str, Tensor]:
        """Copies of the chosen rows that gather gradients."""
        return {name: tensor.index_select(0, rows).requires_grad_() for name, tensor in self.parameters.items()}

    def step(self, rows: Tensor, leaves: dict[str, Tensor], rates: dict[str, Tensor], taken: Tensor) -> None:
        """One Adam step of the chosen rows, ascending, from the gradients gathered by their leaves; what has no rate stays.

        taken: (), whether it is taken at all, which a GPU decides by itself.
        """
        if self.counts.device.type == "cuda":
            from core.training import adam_cuda  # Triton, which a machine without a GPU need not have

            adam_cuda.step(self, rows, leaves, rates, taken)
            return
        if not taken:
            return
        sky = int(torch.searchsorted(rows, self.solid))  # where the dome's begin
        self.counts[rows] += 1
        moved = []
        for name, leaf in leaves.items():
            if leaf.grad is None or name not in rates:
                continue
            columns = len(rates[name])
            leaf.grad.view(len(rows), columns)[sky:, free_columns(name, columns) :] = 0
            moved.append(Moved(self.parameters[name], self.first[name], self.second[name], leaf.grad, rates[name]))
        adam_rows(moved, self.counts, rows)

    def keep(self, mask: Tensor) -> None:
        """Keep the rows where `mask` (N,) is true, and the sky."""
        rows = torch.nonzero(mask | (torch.arange(len(self), device=mask.device) >= self.solid)).squeeze(1)
        self._become({name: tensor.index_select(0, rows) for name, tensor in self.tensors().items()})

    def insert(self, born: dict[str, Tensor]) -> None:
        """Add Gaussians before the sky, with fresh moments and statistics."""
        rows, solid = len(born["means"]), self.solid
        grown = {}
        for name, old in self.tensors().items():
            group, _, part = name.partition(".")
            new = born[part] if group == "parameters" else old.new_zeros(rows, *old.shape[1:])
            grown[name] = torch.cat([old[:solid], new, old[solid:]])
        self._become(grown)

    def _become(self, flat: dict[str, Tensor]) -> None:
        """Take over these tensors, all at once: where memory runs out before, the old ones still fit together."""
        new = Gaussians.from_tensors(flat, self.sky)
        self.parameters, self.first, self.second = new.parameters, new.first, new.second
        self.counts, self.gradient_sum, self.seen = new.counts, new.gradient_sum, new.seen

    def tensors(self) -> dict[str, Tensor]:
        """Everything, flat, for a checkpoint."""
        flat = {f"parameters.{name}": tensor for name, tensor in self.parameters.items()}
        for moment in MOMENTS:
            flat |= {f"{moment}.{name}": tensor for name, tensor in getattr(self, moment).items()}
        return flat | {"counts": self.counts, "gradient_sum": self.gradient_sum, "seen": self.seen}

    @staticmethod
    def from_tensors(flat: dict[str, Tensor], sky: int) -> "Gaussians":
        """The inverse of `tensors`; raises KeyError or ValueError for a set that is incomplete or does not fit together."""
        groups = {
            group: {key.split(".", 1)[1]: tensor for key, tensor in flat.items() if key.startswith(group + ".")}
            for group in ("parameters", *MOMENTS)
        }
        rows = {len(tensor) for tensor in flat.values()}
        if len(rows) != 1 or any(tensor.dtype != torch.float32 for tensor in groups["parameters"].values()):
            raise ValueError(f"{sorted(rows)} Gaussians in tensors of one set, or parameters that are not float32")
        return Gaussians(
            **groups, counts=flat["counts"], gradient_sum=flat["gradient_sum"], seen=flat["seen"], sky=sky
        )


def free_columns(name: str, columns: int) -> int:
    """How many columns of a parameter move in the dome's rows, whose geometry is fixed.

    Seen from one side only, a dome Gaussian needs no more harmonics than DC.
    """
    return {"sh": 3, "latents": columns}.get(name, 0)


def learning_rates(settings: Settings, mean_rate: float, latent_rate: float) -> dict[str, Tensor]:
    """One rate for each element of a row, by parameter."""
    coefficients = coefficient_count(settings.sh_degree)
    sh = torch.full((coefficients, 3), settings.sh_rate * REST_BAND_SHARE)
    sh[0] = settings.sh_rate
    return {
        "means": torch.full((3,), mean_rate),
        "quaternions": torch.full((4,), settings.quaternion_rate),
        "log_scales": torch.full((3,), settings.scale_rate),
        "logit_opacities": torch.full((1,), settings.opacity_rate),
        "sh": sh.flatten(),
        "latents": torch.full((settings.latent_size,), latent_rate),
    }


def initial_gaussians(collection: Collection, settings: Settings, generator: torch.Generator) -> Gaussians:
    """Gaussians at the SfM points, as 3DGS starts, and the dome of the sky behind them."""
    points, colours = collection.points, collection.point_colours
    room = max(settings.max_gaussians // 2, 1)  # the other half is for growth
    if len(points) > room:
        chosen = np.sort(torch.randperm(len(points), generator=generator)[:room].numpy())
        points, colours = points[chosen], colours[chosen]
    distances = cKDTree(points).query(points, k=min(4, len(points)))[0].reshape(len(points), -1)[:, 1:]
    spacing = np.sqrt((distances**2).mean(axis=1)) if distances.size else np.full(len(points), LONE_SPACING)
    scales = np.clip(spacing, LEAST_SCALE, settings.largest_scale / 2)  # a lonely point must not start as haze over everything
    parts = [
        _isotropic(points, scales, colours, np.full(len(points), INITIAL_OPACITY), settings.sh_degree),
    ]
    sky = 0
    if settings.sky == "dome":
        parts.append(sky_dome(collection, settings))
        sky = len(parts[-1])
    parameters = Splats.concatenate(parts).tensors()
    if settings.latent_size and settings.appearance == "full":
        parameters["latents"] = torch.zeros(len(parameters["means"]), settings.latent_size)
    return Gaussians.of(parameters, sky)


def sky_dome(collection: Collection, settings: Settings) -> Splats:
    """Opaque discs on a sphere around scene and cameras: a sky that is made of Gaussians is in every exported file.

    Spread by the Fibonacci lattice. A disc is as wide as the lattice is spaced: so many overlap that less than 1e-3 of what
    is behind shines through.
    """
    count = settings.sky_gaussians
    # Around a camera that stands a million units off by mistake a dome would have holes: log scales are clamped.
    centres = np.stack([photo.camera.centre for photo in collection.photos])[~astray(collection.photos)]
    farthest = float(np.linalg.norm(centres, axis=1).max())
    radius = max(settings.sky_radius, SKY_MARGIN * farthest)
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    ring = np.sqrt(1.0 - height**2)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    width = radius * np.sqrt(4.0 * np.pi / count)
    colours = np.broadcast_to(collection.point_colours.mean(axis=0), normals.shape)
    dome = _isotropic(normals * radius, np.full(count, width), colours, np.full(count, SKY_OPACITY), settings.sh_degree)
    # The rotation that turns z into the normal n: the half-way quaternion (1 + n_z, -n_y, n_x, 0).
    half_way = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(count)], axis=1)
    dome.quaternions = torch.nn.functional.normalize(torch.from_numpy(half_way).float(), dim=1)
    dome.log_scales[:, 2] += float(np.log(SKY_FLATNESS))
    return dome


def _isotropic(means, scales, colours, opacities, degree: int) -> Splats:
    rows = len(means)
    sh = torch.zeros(rows, coefficient_count(degree), 3)
    sh[:, 0] = dc_of_colour(torch.from_numpy(np.array(colours, dtype=np.float32)))
    quaternions = torch.zeros(rows, 4)
    quaternions[:, 0] = 1
    return Splats(
        means=torch.from_numpy(np.asarray(means, dtype=np.float32)).contiguous(),
        quaternions=quaternions,
        log_scales=torch.from_numpy(np.log(scales).astype(np.float32))[:, None].repeat(1, 3),
        logit_opacities=torch.logit(torch.from_numpy(np.asarray(opacities, dtype=np.float32))),
        sh=sh,
    )
