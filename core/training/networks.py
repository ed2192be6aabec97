"""Adam for the networks: encoder, mask, SH transfer and tables, each at its own rate."""

import torch
from torch import Tensor, nn

from core.config import Settings
from core.training import schedule


def optimizer_of(model: nn.Module, settings: Settings) -> torch.optim.Adam | None:
    """Of all weights of the model, None if it has none."""
    rates = {
        "encoder.unet": settings.network_rate,
        "encoder": settings.encoder_rate,
        "embedding_table": settings.embedding_rate,
    }
    groups: dict[float, list[Tensor]] = {}
    for name, weight in model.named_parameters():
        rate = next((rate for part, rate in rates.items() if name.startswith(part)), settings.network_rate)
        groups.setdefault(rate, []).append(weight)
    if not groups:
        return None
    return torch.optim.Adam([{"params": g, "lr": rate, "rate": rate} for rate, g in groups.items()], fused=True)


def update(optimizer: torch.optim.Adam, progress: float, learnt: Tensor) -> None:
    """One step at the rates of this moment, from gradients that are then gone; on a GPU only if `learnt` () is true."""
    for group in optimizer.param_groups:
        group["lr"] = schedule.decayed(group["rate"], progress, schedule.NETWORK_RATE_DECAY)
    if learnt.device.type != "cpu":
        optimizer.found_inf = (~learnt).float()  # as torch's GradScaler leaves the choice to the GPU
    optimizer.step()
    optimizer.zero_grad(set_to_none=True)
