"""Vectors on the stack at whole cache lines.

Numbers that a loop does not find a register for go to the stack, where LLVM keeps 16 bytes of alignment, and not those 64
of a vector, unless it knows in time that something needs more. Where in a cache line the stack begins is drawn anew for
every process: in most of them each such vector would lie across two lines, and a loop that is full of them be a third slower.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LINE = 64  # bytes


@intrinsic
def align_stack(context):
    """To be called anywhere in a function, or in the body of a parallel loop, which is one."""

    def generate(context, builder, signature, given):
        place = cgutils.alloca_once(builder, ir.IntType(8))
        place.align = LINE
        pointer = ir.IntType(8).as_pointer()
        # an empty instruction that is handed the place, so that it is not found to be of no use
        builder.asm(ir.FunctionType(ir.VoidType(), [pointer]), "", "r", [place], side_effect=True)
        return context.get_dummy_value()

    return types.void(), generate
