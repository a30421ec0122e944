"""Stretches of a line side by side, in a table of LANES columns: eight by eight numbers are turned in registers, which no
loop is compiled to. Indices are unsigned, and not checked.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 32

EIGHT, INT = ir.VectorType(ir.DoubleType(), 8), ir.IntType(32)
# of two vectors of each step of a transposition: what goes on in the first, what in the second
STEPS = (
    (4, (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)),
    (2, (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)),
    (1, (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)),
)


def _turned(builder, rows):
    rows = list(rows)
    for apart, low, high in STEPS:
        masks = [ir.Constant(ir.VectorType(INT, 8), list(mask)) for mask in (low, high)]
        for n in range(8):
            if n & apart == 0:
                pair = rows[n], rows[n + apart]
                rows[n], rows[n + apart] = (builder.shuffle_vector(*pair, mask) for mask in masks)
    return rows


def _address(context, builder, array, value, index):
    data = context.make_array(array)(context, builder, value).data
    return builder.bitcast(builder.gep(data, [index]), EIGHT.as_pointer())


def _copy(inward):
    def generate(context, builder, signature, given):
        table, at, line, *starts = given
        rows = [builder.add(at, ir.Constant(at.type, n * LANES)) for n in range(8)]
        table = [_address(context, builder, signature.args[0], table, row) for row in rows]
        line = [_address(context, builder, signature.args[2], line, start) for start in starts]
        source, target = (line, table) if inward else (table, line)
        for values, address in zip(_turned(builder, [builder.load(a, align=8) for a in source]), target, strict=True):
            builder.store(values, address, align=8)
        return context.get_dummy_value()

    return generate


@intrinsic
def copy_in(context, table, at, line, s0, s1, s2, s3, s4, s5, s6, s7):
    """table[at + r LANES + n] <- line[s_n + r], r, n = 0..7."""
    return types.void(table, at, line, s0, s1, s2, s3, s4, s5, s6, s7), _copy(True)


@intrinsic
def copy_out(context, table, at, line, s0, s1, s2, s3, s4, s5, s6, s7):
    """The other way round."""
    return types.void(table, at, line, s0, s1, s2, s3, s4, s5, s6, s7), _copy(False)
