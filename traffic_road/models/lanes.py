"""Stretches of a line side by side, in a table of lanes: eight by eight numbers are turned in registers, which no loop is
compiled to. Indices are unsigned, and not checked.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 32  # of the table that cars cross
ABREAST = 8  # of the tables that a line is relaxed in

INT = ir.IntType(32)
# of two vectors of each step of a transposition: what goes on in the first, what in the second
STEPS = (
    (4, (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)),
    (2, (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)),
    (1, (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)),
)


def vector(size):
    return ir.VectorType(ir.DoubleType(), size)


def address(context, builder, array, value, index, size):
    """Where a vector of `size` numbers begins, at `index` of an array."""
    data = context.make_array(array)(context, builder, value).data
    return builder.bitcast(builder.gep(data, [index]), vector(size).as_pointer())


def further(builder, index, more):
    return builder.add(index, ir.Constant(index.type, more % 2**64))


def _turned(builder, rows):
    rows = list(rows)
    for apart, low, high in STEPS:
        masks = [ir.Constant(ir.VectorType(INT, 8), list(mask)) for mask in (low, high)]
        for n in range(8):
            if n & apart == 0:
                pair = rows[n], rows[n + apart]
                rows[n], rows[n + apart] = (builder.shuffle_vector(*pair, mask) for mask in masks)
    return rows


def _copy(inward, lanes):
    def generate(context, builder, signature, given):
        table, at, line, *starts = given
        rows = [further(builder, at, n * lanes) for n in range(8)]
        table = [address(context, builder, signature.args[0], table, row, 8) for row in rows]
        line = [address(context, builder, signature.args[2], line, start, 8) for start in starts]
        source, target = (line, table) if inward else (table, line)
        for values, place in zip(_turned(builder, [builder.load(a, align=8) for a in source]), target, strict=True):
            builder.store(values, place, align=8)
        return context.get_dummy_value()

    return generate


def _make_copy(inward, lanes):
    def copy(context, table, at, line, s0, s1, s2, s3, s4, s5, s6, s7):
        return types.void(table, at, line, s0, s1, s2, s3, s4, s5, s6, s7), _copy(inward, lanes)

    return intrinsic(copy)


# table[at + r LANES + n] <- line[s_n + r], r, n = 0..7, and the other way round
copy_in, copy_out = _make_copy(True, LANES), _make_copy(False, LANES)
copy_in_abreast, copy_out_abreast = _make_copy(True, ABREAST), _make_copy(False, ABREAST)
