"""Compile every CUDA kernel for GPUs that are not here, and print what each takes:
python -m tests.rasterizer.compiled_kernels 75 90

A program of its own, because Triton decides when it is imported whether kernels are compiled or interpreted. Prints
JSON: {"sm_75": {kernel: {"registers": a thread, "spilled": bytes stored and loaded again}}}, in SH degree 3, the most
there is, unless the name says otherwise, as "blend_forward RECORD=True" does.
"""

import contextlib
import io
import json
import re
import sys

import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from core.appearance import positional_encoding_cuda
from core.kernels.triton_launch import FUSED, UNFUSED
from core.rasterizer.cuda import bin, blend_backward, blend_forward, project, project_backward
from core.rasterizer.cuda.backend import MOST_PARTS
from core.training.gaussians import adam_cuda, chosen_rows_cuda, density_statistics_cuda
from core.training.losses import photometric_cuda, residual_cuda

PLAIN = {"COEFFICIENTS": 1, "PROBED": False}  # a look of degree 0, drawn and not trained
DIVIDED = {"PARTS": MOST_PARTS, "NOTES": True}  # the tiles of a small picture
KERNELS = [  # with the options that they are launched with, and what differs from CONSTANTS
    (project.find_visible, {"num_warps": project.WARPS, **UNFUSED}, {}),
    (project.project, {"num_warps": project.WARPS, **UNFUSED}, {}),
    (project.project, {"num_warps": project.WARPS, **UNFUSED}, PLAIN),
    (bin.list_tiles, {"num_warps": bin.WARPS, **UNFUSED}, {}),
    (blend_forward.blend_forward, {"num_warps": blend_forward.WARPS[1], **UNFUSED}, {}),
    (blend_forward.blend_forward, {"num_warps": blend_forward.WARPS[1], **UNFUSED}, {"RECORD": True}),
    (blend_forward.blend_forward, {"num_warps": blend_forward.WARPS[MOST_PARTS], **UNFUSED}, DIVIDED),
    (blend_backward.blend_backward, {"num_warps": blend_backward.WARPS, **FUSED}, {}),
    (blend_backward.blend_backward, {"num_warps": blend_backward.WARPS, **FUSED}, DIVIDED),
    (blend_backward.add_up, {"num_warps": 1, **UNFUSED}, {}),
    (project_backward.project_backward, {"num_warps": project_backward.WARPS, **UNFUSED}, {}),
    (project_backward.project_backward, {"num_warps": project_backward.WARPS, **UNFUSED}, PLAIN),
    (chosen_rows_cuda.take_rows, FUSED, {}),
    (adam_cuda.update, {"num_warps": adam_cuda.WARPS, **FUSED}, {}),
    (density_statistics_cuda.add_view, FUSED, {}),
    (positional_encoding_cuda.encode_positions, FUSED, {}),
    (photometric_cuda.blur_products_down, FUSED, {}),
    (photometric_cuda.blur_down, FUSED, {}),
    (photometric_cuda.compare, FUSED, {}),
    (photometric_cuda.combine, FUSED, {}),
    (residual_cuda.weigh_residual, FUSED, {}),
]
# What the parameters of that name are; all others are arrays of float32.
TYPES = {
    **dict.fromkeys(("count", "sections", "columns", "width", "height", "size", "solid"), "i32"),
    **dict.fromkeys(("background_red", "background_green", "background_blue", "ssim_weight", "weight"), "fp32"),
    # Of each parameter.
    **dict.fromkeys(("sources", "copies", "values", "first", "second", "gradients"), ("*fp32",) * 6),
    **dict.fromkeys(("order", "slot_starts", "tile_starts", "part_ends", "entry_slots", "rows", "shown"), "*i64"),
    **dict.fromkeys(("tile_counts", "owners", "entry_splats", "counts", "visible"), "*i32"),
    "slot_tiles": "*i16",
    "blended_slots": "*u8",
    "taken": "*i1",
}
CONSTANTS = {
    "COEFFICIENTS": 16,
    "COLUMNS": (3, 4, 3, 1, 48, 16),
    "FREE": (0, 0, 0, 0, 3, 16),
    "ROWS": adam_cuda.ROWS,
    "OCTAVES": 4,
    "PARTS": 1,
    "NOTES": False,
    "PROBED": True,
    "RECORD": False,
}


def name_of(kernel, changes: dict) -> str:
    return " ".join([kernel.fn.__name__, *(f"{constant}={value}" for constant, value in changes.items())])


def compiled(kernel, options: dict, changes: dict, capability: int) -> dict[str, int]:
    """What ptxas says of a kernel. changes: of CONSTANTS."""
    block = getattr(sys.modules[kernel.fn.__module__], "BLOCK", None)
    constants = {
        name: value for name, value in {**CONSTANTS, **changes, "BLOCK": block}.items() if name in kernel.arg_names
    }
    signature = {name: "constexpr" if name in constants else TYPES.get(name, "*fp32") for name in kernel.arg_names}
    target = GPUTarget("cuda", capability, 32)
    arrays = [(place,) for place, name in enumerate(kernel.arg_names) if str(signature[name]).startswith("*")]
    arrays += [
        (place, each)
        for place, name in enumerate(kernel.arg_names)
        if isinstance(signature[name], tuple)
        for each in range(len(signature[name]))
    ]
    # Bytes: torch's arrays begin so, and a launch looks.
    aligned = {array: [["tt.divisibility", 16]] for array in arrays}
    with contextlib.redirect_stdout(io.StringIO()) as log:
        triton.compile(ASTSource(kernel, signature, constants, aligned), target=target, options=options)
    registers = re.search(r"Used (\d+) registers", log.getvalue())
    spilled = re.search(r"(\d+) bytes spill stores", log.getvalue())
    return {"registers": int(registers.group(1)), "spilled": int(spilled.group(1))}


if __name__ == "__main__":
    triton.knobs.compilation.always_compile = True  # what comes out of Triton's cache has no log
    triton.knobs.nvidia.dump_ptxas_log = True
    found = {
        f"sm_{capability}": {
            name_of(kernel, changes): compiled(kernel, options, changes, capability)
            for kernel, options, changes in KERNELS
        }
        for capability in map(int, sys.argv[1:])
    }
    print(json.dumps(found))
