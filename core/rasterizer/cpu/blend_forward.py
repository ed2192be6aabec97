"""The picture: splats blended over each other, front to back, tile by tile (3DGS equation 3)."""

import numpy as np

from core.kernels.compiled import exact_kernel, exact_part
from core.kernels.simd import (
    LANES,
    bits,
    broadcast,
    fetch_add,
    lane_maximum,
    load,
    lowest_set_bit,
    maximum,
    multiply_add,
    prefetch,
    store,
)
from core.rasterizer import layout
from core.rasterizer.cpu.bin import SLOT, SPLAT
from core.rasterizer.cpu.blend import (
    BATCH,
    CHUNKS,
    ROW_TERMS,
    ZERO,
    alpha_in_chunk,
    blended,
    clamped,
    touched_chunks,
    write_row_terms,
)
from core.rasterizer.cpu.footprint import tiles_along
from core.rasterizer.layout import TILE

# What a chunk keeps, side by side: its eight transmittances, negative when finished (see `blended`), then red, green
# and blue.
RED, GREEN, BLUE = LANES, 2 * LANES, 3 * LANES
STATE = 4 * LANES


@exact_kernel
def blend_forward(
    taken, first, step, tile_starts, entries, footprints, background, image, drawn_chunks, strongest,
):  # fmt: skip
    """Write the picture (height, width, 3).

    taken: (tiles,) int64, shared by all threads; the tiles that still have a zero are drawn, from `first` on in steps
    of `step`, 1 or -1. drawn_chunks: (slots,) uint32, zeros; becomes the chunks that each splat touches and that were
    unfinished when its batch began. Some of them may be finished before it is its turn: the backward pass, which goes
    the same way, finds that out again. strongest: (slots,) float32 for the largest alpha * transmittance of each, or
    empty where it is not wanted.
    """
    height, width = image.shape[:2]
    columns = tiles_along(width)
    state = np.empty(CHUNKS * STATE, np.float32)
    terms = np.empty(BATCH * ROW_TERMS, np.float32)
    for number in range(len(taken)):
        tile = (first + step * number) % len(taken)
        if fetch_add(taken, tile, 1) != 0:
            continue
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        centre_x, centre_y = np.float32(left + TILE / 2), np.float32(top + TILE / 2)
        clear(state, width - left, height - top)
        for begin in range(tile_starts[tile], tile_starts[tile + 1], BATCH):
            unfinished = unfinished_chunks(state)
            if unfinished == 0:
                break
            end = min(begin + BATCH, tile_starts[tile + 1])
            for entry in range(begin, end):
                # What the next batch will need: the lists jump about in memory, and waiting for it took a fifth of the
                # time.
                ahead = min(entry + BATCH, len(entries) - 1)
                prefetch(footprints, entries[ahead, SPLAT] * layout.FOOTPRINT_COLUMNS)
                prefetch(drawn_chunks, entries[ahead, SLOT])
                i, at = entries[entry, SPLAT], (entry - begin) * ROW_TERMS
                write_row_terms(footprints, i, centre_x, centre_y, terms, at)
                chunks = touched_chunks(footprints[i, layout.SHARPNESS], terms, at) & unfinished
                drawn_chunks[entries[entry, SLOT]] = chunks
            for entry in range(begin, end):
                slot, at = entries[entry, SLOT], (entry - begin) * ROW_TERMS
                largest = blend_splat(drawn_chunks[slot], footprints, entries[entry, SPLAT], terms, at, state)
                if len(strongest) > 0:
                    strongest[slot] = lane_maximum(largest)
        write_tile(state, background, left, top, image)


@exact_part
def clear(state, width, height):
    """Nothing blended yet; pixels beyond `width` and `height` (from the tile's corner) are finished from the start."""
    state[:] = 0
    for chunk in range(CHUNKS):
        y, x = chunk % TILE, chunk // TILE * LANES
        for lane in range(LANES):
            state[chunk * STATE + lane] = 1.0 if x + lane < width and y < height else -1.0


@exact_part
def unfinished_chunks(state):
    chunks = np.uint32(0)
    for chunk in range(CHUNKS):
        if bits(load(state, chunk * STATE) >= broadcast(ZERO)) != 0:
            chunks |= np.uint32(1) << np.uint32(chunk)
    return chunks


@exact_part
def blend_splat(chunks, footprints, i, terms, at, state):
    """Blend splat `i` into the given chunks; lane by lane the largest weight that it got."""
    sharpness = broadcast(footprints[i, layout.SHARPNESS])
    red = broadcast(footprints[i, layout.RED])
    green = broadcast(footprints[i, layout.GREEN])
    blue = broadcast(footprints[i, layout.BLUE])
    largest = broadcast(ZERO)
    while chunks != 0:
        chunk = lowest_set_bit(chunks)
        chunks &= chunks - np.uint32(1)
        here = chunk * STATE
        light = load(state, here)
        alpha = clamped(alpha_in_chunk(chunk, sharpness, terms, at))
        _, weight, light = blended(light, alpha)
        store(state, here, light)
        store(state, here + RED, multiply_add(weight, red, load(state, here + RED)))
        store(state, here + GREEN, multiply_add(weight, green, load(state, here + GREEN)))
        store(state, here + BLUE, multiply_add(weight, blue, load(state, here + BLUE)))
        largest = maximum(largest, weight)
    return largest


@exact_part
def write_tile(state, background, left, top, image):
    """Put the tile's pixels over the background into the picture."""
    height, width = image.shape[:2]
    for y in range(top, min(top + TILE, height)):
        for x in range(left, min(left + TILE, width)):
            chunk = (y - top) + (x - left) // LANES * TILE
            here = chunk * STATE + (x - left) % LANES
            light = abs(state[here])
            image[y, x, 0] = state[here + RED] + light * background[0]
            image[y, x, 1] = state[here + GREEN] + light * background[1]
            image[y, x, 2] = state[here + BLUE] + light * background[2]
