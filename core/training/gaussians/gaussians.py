"""The Gaussians while they learn: parameters, Adam moments and the statistics that density control needs."""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.config import Settings
from core.scene.harmonics import coefficient_count
from core.scene.splats import Splats
from core.training import schedule
from core.training.gaussians.adam import Moved, adam_rows
from core.training.gaussians.chosen_rows import chosen_rows

REST_BAND_SHARE = 1 / 20  # 3DGS: bands above DC learn twenty times slower
MOMENTS = ("first", "second")


@dataclass
class Gaussians:
    """N Gaussians and the `sky_count` last rows among them: the dome, whose geometry is fixed and never densified.

    parameters: the tensors of Splats and, if wanted, `latents` (N, L). first, second: Adam moments of the same shapes.
    counts: (N,) int32 Adam steps. gradient_sum, seen: (N,) what density control gathers between two rounds.
    """

    parameters: dict[str, Tensor]
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    counts: Tensor
    gradient_sum: Tensor
    seen: Tensor
    sky_count: int

    @staticmethod
    def of(parameters: dict[str, Tensor], sky_count: int) -> "Gaussians":
        """Fresh moments and statistics around these parameters."""
        rows = len(parameters["means"])
        return Gaussians(
            parameters=parameters,
            first={name: torch.zeros_like(tensor) for name, tensor in parameters.items()},
            second={name: torch.zeros_like(tensor) for name, tensor in parameters.items()},
            counts=torch.zeros(rows, dtype=torch.int32),
            gradient_sum=torch.zeros(rows),
            seen=torch.zeros(rows),
            sky_count=sky_count,
        )

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def solid_count(self) -> int:
        """The number of Gaussians that are not sky."""
        return len(self) - self.sky_count

    @property
    def kind(self) -> tuple[int, dict[str, torch.Size]]:
        """What training does not change: how many are sky, and the shape that a row has in each tensor."""
        return self.sky_count, {name: tensor.shape[1:] for name, tensor in self.tensors().items()}

    @property
    def splats(self) -> Splats:
        """The base Gaussians, sharing memory with the parameters."""
        return splats_of(self.parameters)

    @property
    def latents(self) -> Tensor | None:
        """(N, L); None where Gaussians have none."""
        return self.parameters.get("latents")

    def to(self, device: torch.device) -> "Gaussians":
        """The same Gaussians on `device`."""
        return Gaussians.from_tensors(
            {name: tensor.to(device) for name, tensor in self.tensors().items()}, self.sky_count
        )

    def leaves(self, rows: Tensor) -> dict[str, Tensor]:
        """Copies of the chosen rows that gather gradients."""
        return {name: copy.requires_grad_() for name, copy in chosen_rows(self.parameters, rows).items()}

    def step(self, rows: Tensor, leaves: dict[str, Tensor], rates: dict[str, Tensor], taken: Tensor) -> None:
        """One Adam step of the chosen rows, ascending,
        from the gradients gathered by their leaves; what has no rate stays.

        taken: (), whether it is taken at all, which a GPU decides by itself.
        """
        if self.counts.device.type == "cuda":
            from core.training.gaussians import adam_cuda  # Triton, which a machine without a GPU need not have

            adam_cuda.step(self, rows, leaves, rates, taken)
            return
        if not taken:
            return
        sky = int(torch.searchsorted(rows, self.solid_count))  # where the dome's begin
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
        rows = torch.nonzero(mask | (torch.arange(len(self), device=mask.device) >= self.solid_count)).squeeze(1)
        self._become({name: tensor.index_select(0, rows) for name, tensor in self.tensors().items()})

    def insert(self, born: dict[str, Tensor]) -> None:
        """Add Gaussians before the sky, with fresh moments and statistics."""
        rows, solid = len(born["means"]), self.solid_count
        grown = {}
        for name, old in self.tensors().items():
            group, _, part = name.partition(".")
            new = born[part] if group == "parameters" else old.new_zeros(rows, *old.shape[1:])
            grown[name] = torch.cat([old[:solid], new, old[solid:]])
        self._become(grown)

    def _become(self, flat: dict[str, Tensor]) -> None:
        """Take over these tensors, all at once: where memory runs out before, the old ones still fit together."""
        vars(self).update(vars(Gaussians.from_tensors(flat, self.sky_count)))

    def tensors(self) -> dict[str, Tensor]:
        """All tensors by flat name, as a checkpoint stores them."""
        flat = {f"parameters.{name}": tensor for name, tensor in self.parameters.items()}
        for moment in MOMENTS:
            flat |= {f"{moment}.{name}": tensor for name, tensor in getattr(self, moment).items()}
        return flat | {"counts": self.counts, "gradient_sum": self.gradient_sum, "seen": self.seen}

    @staticmethod
    def from_tensors(flat: dict[str, Tensor], sky_count: int) -> "Gaussians":
        """The inverse of `tensors`;
        raises KeyError or ValueError for a set that is incomplete or does not fit together."""
        groups = {
            group: {key.split(".", 1)[1]: tensor for key, tensor in flat.items() if key.startswith(group + ".")}
            for group in ("parameters", *MOMENTS)
        }
        rows = {len(tensor) for tensor in flat.values()}
        if len(rows) != 1 or any(
            tensor.dtype != torch.float32 for group in groups.values() for tensor in group.values()
        ):
            raise ValueError(
                f"{sorted(rows)} Gaussians in tensors of one set, or parameters or moments that are not float32"
            )
        shapes, *others = ({name: tensor.shape for name, tensor in group.items()} for group in groups.values())
        if any(other != shapes for other in others) or not 0 <= sky_count <= min(rows):
            raise ValueError(
                f"moments of other shapes than the parameters, or a sky of {sky_count} of {min(rows)} Gaussians"
            )
        return Gaussians(
            **groups, counts=flat["counts"], gradient_sum=flat["gradient_sum"], seen=flat["seen"], sky_count=sky_count
        )


def splats_of(parameters: dict[str, Tensor]) -> Splats:
    """Those of the parameters that are drawn, sharing memory with them: all but the latents."""
    return Splats(**{name: tensor for name, tensor in parameters.items() if name != "latents"})


def free_columns(name: str, columns: int) -> int:
    """How many columns of a parameter move in the dome's rows, whose geometry is fixed.

    Seen from one side only, a dome Gaussian needs no more harmonics than DC.
    """
    return {"sh": 3, "latents": columns}.get(name, 0)


def learning_rates(settings: Settings, progress: float) -> dict[str, Tensor]:
    """One rate for each element of a row, by parameter, at this moment of the run; what does not learn yet has none."""
    coefficients = coefficient_count(settings.sh_degree)
    sh = torch.full((coefficients, 3), settings.sh_rate * REST_BAND_SHARE)
    sh[0] = settings.sh_rate
    rates = {
        "means": torch.full((3,), schedule.decayed(settings.mean_rate, progress, schedule.MEAN_RATE_DECAY)),
        "quaternions": torch.full((4,), settings.quaternion_rate),
        "log_scales": torch.full((3,), settings.scale_rate),
        "logit_opacities": torch.full((1,), settings.opacity_rate),
        "sh": sh.flatten(),
        "latents": torch.full(
            (settings.latent_size,), schedule.decayed(settings.embedding_rate, progress, schedule.NETWORK_RATE_DECAY)
        ),
    }
    if progress < settings.geometry_from:
        rates = {name: rates[name] for name in ("sh", "latents")}
    if progress < settings.latents_from:
        del rates["latents"]
    return rates
