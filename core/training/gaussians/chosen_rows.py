"""Some rows of several tensors at once."""

import torch
from torch import Tensor


def chosen_rows(tensors: dict[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    """Detached copies of these rows of each tensor.

    tensors: of the same length, by name. rows: (V,) int64; on a GPU, if all tensors are float32 and contiguous, a row
    of -1 becomes zeros.
    """
    if rows.device.type == "cuda" and all(
        tensor.dtype == torch.float32 and tensor.is_contiguous() for tensor in tensors.values()
    ):
        from core.training.gaussians import chosen_rows_cuda  # Triton, which a machine without a GPU need not have

        return chosen_rows_cuda.chosen_rows(tensors, rows)
    return {name: tensor.detach().index_select(0, rows) for name, tensor in tensors.items()}
