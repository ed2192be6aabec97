"""Tile lists: which Gaussians touch which tile, front to back, ties by index.

Depths are sorted once and the lists filled in that order, by counting; (tile, depth) pairs are never sorted. An entry of a
list is a pair of a Gaussian and its slot. Slots are numbered Gaussian by Gaussian: what a tile writes to its slots is later
summed a Gaussian at a time, without atomics and in the same order for any number of threads.
"""

import numpy as np
from numba import njit

from core.rasterizer.cpu import footprint
from core.rasterizer.cpu.footprint import touched_columns, touched_rows

DIGIT_BITS = 11  # three passes for 32 bits; the histograms stay in the first-level cache
DIGITS = 1 << DIGIT_BITS


@njit(cache=True, nogil=True, error_model="numpy")
def front_to_back(depths, tile_counts):
    """The Gaussians that touch a tile, by depth and then by index: a stable radix sort of their float32 depths."""
    count = np.count_nonzero(tile_counts)
    order, other_order = np.empty(count, np.int32), np.empty(count, np.int32)
    keys, other_keys = np.empty(count, np.uint32), np.empty(count, np.uint32)
    # Depths are positive, and positive floats sort like the integers with the same bits.
    depth_bits = depths.view(np.uint32)
    histograms = np.zeros((3, DIGITS), np.int64)
    position = 0
    for i in range(len(depths)):
        if tile_counts[i] > 0:
            key = depth_bits[i]
            order[position], keys[position] = i, key
            position += 1
            for digit in range(3):
                histograms[digit, (key >> np.uint32(digit * DIGIT_BITS)) & np.uint32(DIGITS - 1)] += 1
    for digit in range(3):
        cursors = histograms[digit]
        start = 0
        for value in range(DIGITS):
            start, cursors[value] = start + cursors[value], start
        for k in range(count):
            value = (keys[k] >> np.uint32(digit * DIGIT_BITS)) & np.uint32(DIGITS - 1)
            target = cursors[value]
            cursors[value] = target + 1
            other_order[target], other_keys[target] = order[k], keys[k]
        order, other_order = other_order, order
        keys, other_keys = other_keys, keys
    return order


@njit(cache=True, nogil=True, error_model="numpy")
def running_starts(counts):
    """Where each part begins, and at the end the total: (len(counts) + 1,) int64."""
    starts = np.empty(len(counts) + 1, np.int64)
    total = np.int64(0)
    for i in range(len(counts)):
        starts[i] = total
        total += counts[i]
    starts[len(counts)] = total
    return starts


@njit(cache=True, nogil=True, error_model="numpy")
def fill_lists(order, footprints, slot_starts, tile_starts, size, entry_splats, entry_slots):
    """Write the lists of all tiles: tile t has entries tile_starts[t] to tile_starts[t + 1]."""
    columns = (size[0] + footprint.TILE - 1) // footprint.TILE
    cursors = tile_starts.copy()
    for i in order:
        x, y = footprints[i, footprint.X] * 1.0, footprints[i, footprint.Y] * 1.0
        slope, sharpness = footprints[i, footprint.SLOPE] * 1.0, footprints[i, footprint.SHARPNESS] * 1.0
        fall, strength = footprints[i, footprint.FALL] * 1.0, footprints[i, footprint.STRENGTH] * 1.0
        slot = slot_starts[i]
        # The same functions that counted, on the same numbers: the slots are filled exactly.
        first_row, last_row = touched_rows(y, fall, strength, size[1])
        for tile_row in range(first_row, last_row):
            first, last = touched_columns(x, y, slope, sharpness, fall, strength, tile_row, size[0])
            for tile in range(tile_row * columns + first, tile_row * columns + last):
                position = cursors[tile]
                cursors[tile] = position + 1
                entry_splats[position], entry_slots[position] = i, slot
                slot += 1
