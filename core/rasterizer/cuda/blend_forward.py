"""The picture: splats blended over each other, front to back, tile by tile (3DGS equation 3)."""

import triton
import triton.language as tl

from core.rasterizer.cuda.blend import (
    ALPHA_MAX,
    BATCH,
    PIXELS,
    blended,
    coverage,
    note_of,
    pixels_of,
    read_splat,
    section_length,
    splat_of,
)

WARPS = {1: 2, 8: 1}  # by the parts that a tile is divided into: four pixels per thread, or one


@triton.jit(do_not_specialize=["sections", "columns", "width", "height"])
def blend_forward(
    tile_starts, entry_splats, entry_slots, footprints, image, part_ends, notes, strongest,
    sections, columns, width, height, background_red, background_green, background_blue,
    PARTS: tl.constexpr, NOTES: tl.constexpr, RECORD: tl.constexpr,
):  # fmt: skip
    """Write one of PARTS parts of a tile into the picture (height, width, 3), and where its list was left.

    part_ends: (tiles, PARTS) int64, the entry before which all pixels were finished. notes: (tiles, sections, 4,
    PIXELS), light and colours before each section of the list that is reached; written if NOTES. strongest: (slots,),
    to become the largest alpha * transmittance of each slot; written if RECORD, which goes with one part.
    """
    tile, part = tl.program_id(0) // PARTS, tl.program_id(0) % PARTS
    lane = part * (PIXELS // PARTS) + tl.arange(0, PIXELS // PARTS)
    x, y, offset, inside = pixels_of(tile, lane, columns, width, height)
    light = tl.where(inside, 1.0, -1.0)
    nothing = tl.zeros_like(x)
    red, green, blue = nothing, nothing, nothing
    entry, end = tl.load(tile_starts + tile), tl.load(tile_starts + tile + 1)
    unfinished = entry < end
    length, note = section_length(end - entry, sections), notes + note_of(tile, 0, sections, lane)
    next_section = entry
    this, other = splat_of(entry_splats, entry, end), splat_of(entry_splats, entry + 1, end)
    shape, colour = read_splat(footprints, this, unfinished)
    while unfinished:
        if NOTES:  # noqa: SIM102 - when it is compiled
            if entry == next_section:
                tl.store(note, light)
                tl.store(note + PIXELS, red)
                tl.store(note + 2 * PIXELS, green)
                tl.store(note + 3 * PIXELS, blue)
                note += 4 * PIXELS
                next_section += length
        stop = tl.minimum(entry + BATCH, end)
        while entry < stop:
            other_shape, other_colour = read_splat(footprints, other, entry + 1 < end)
            this = splat_of(entry_splats, entry + 2, end)
            weight, light, red, green, blue = over(shape, colour, light, red, green, blue, x, y)
            if RECORD:
                tl.store(strongest + tl.load(entry_slots + entry), tl.max(weight, axis=0))
            shape, colour = read_splat(footprints, this, entry + 2 < end)
            other = splat_of(entry_splats, entry + 3, end)
            weight, light, red, green, blue = over(other_shape, other_colour, light, red, green, blue, x, y)
            if RECORD:
                slot = tl.load(entry_slots + entry + 1, mask=entry + 1 < end, other=0)
                tl.store(strongest + slot, tl.max(weight, axis=0), mask=entry + 1 < end)
            entry += 2
        unfinished = (entry < end) & (tl.max(light, axis=0) > 0)
    entry = tl.minimum(entry, end)
    tl.store(part_ends + tl.program_id(0), entry)
    light = tl.abs(light)
    tl.store(image + 3 * offset, red + light * background_red, mask=inside)
    tl.store(image + 3 * offset + 1, green + light * background_green, mask=inside)
    tl.store(image + 3 * offset + 2, blue + light * background_blue, mask=inside)


@triton.jit
def over(shape, colour, light, red, green, blue, x, y):
    """The weight of a splat in the pixels, the light behind it, and the colours with it."""
    alpha, _, _ = coverage(shape, x, y)
    _, weight, light, _ = blended(light, tl.minimum(alpha, ALPHA_MAX))
    return (
        weight,
        light,
        tl.fma(weight, colour[0], red),
        tl.fma(weight, colour[1], green),
        tl.fma(weight, colour[2], blue),
    )
