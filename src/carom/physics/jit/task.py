"""A kernel and its arguments as two addresses, so that any thread can do a piece of the work without the interpreter.

A helper that calls through the interpreter waits for its lock: 10 to 30 µs for half a dozen pieces. Numba can pass a
kernel to another kernel as a value, but then compiles the other one again for each kernel and each set of arguments.
"""

from __future__ import annotations

import ctypes
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import callconv, cgutils

from carom.physics.jit.decorators import compile_for
from carom.physics.jit.intrinsics import instruction

WORD = ir.IntType(64)
PIECES_OF = ir.FunctionType(ir.VoidType(), [WORD, WORD, WORD])  # address of the job, first piece, one after the last
FAULT, INFO, KERNEL, COUNT, PIECES, ARGUMENTS = range(6)  # of a job; error code (0: none), exception


def address_of(kernel: Callable[..., None], kind: int) -> int:
    """Return the address of a kernel's machine code for (lo, hi, *arguments) of a kind, see `kind_of`."""
    for compiled in kernel.overloads.values():  # type: ignore[attr-defined]
        if _kind(compiled.signature.args[2:]) == kind:
            address: int = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
            return address
    raise TypeError(f"{kernel} has never been called with such arguments")


def code_for(kernel: Callable[..., None], *arguments: Any) -> int:
    """Compile a kernel for (lo, hi, *arguments), or load it; return the address of its machine code."""
    compile_for(kernel, 0, 0, *arguments)
    return address_of(kernel, kind_for(*arguments))


def kind_for(*arguments: Any) -> int:
    """Return what `kind_of` returns in a kernel."""
    type_of: Any = numba.typeof
    return _kind([type_of(argument) for argument in arguments])


def _kind(kinds: Sequence[Any]) -> int:
    return zlib.crc32(repr(tuple(kinds)).encode()) + 1


@instruction
def kind_of(typing: Any, arguments: Any) -> Any:
    """Return a number, not 0, that identifies the types of a tuple's members."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return WORD(_kind(list(arguments)))

    return types.int64(arguments), generate


@instruction
def lay_out(typing: Any, kernel: Any, count: Any, pieces: Any, arguments: Any) -> Any:
    """Lay out a job, valid until the caller returns: a kernel to be called on [0, count), cut into pieces.

    Returns
    -------
    doer, job
        Addresses of the function that does pieces of such a job, and of the job.
    """
    kinds = (types.int64, types.int64, *arguments)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        layout = ir.LiteralStructType([WORD] * ARGUMENTS + [context.get_value_type(arguments)])
        job = cgutils.alloca_once(builder, layout)  # type: ignore[no-untyped-call]
        for k, value in enumerate((WORD(0), WORD(0), *args)):
            builder.store(value, _member(builder, job, k))
        doer = _doer(context, builder.module, layout, kinds)
        addresses = [builder.ptrtoint(pointer, WORD) for pointer in (doer, job)]
        return context.make_tuple(builder, signature.return_type, addresses)

    pair = types.UniTuple(types.int64, 2)  # type: ignore[no-untyped-call]
    return pair(types.int64, types.int64, types.int64, arguments), generate


def _doer(context: Any, module: Any, layout: Any, kinds: Sequence[Any]) -> Any:
    """Write the function that calls the kernel of a job on some pieces.

    It keeps the first exception of a job there, for `raise_fault`.
    """
    doer = ir.Function(module, PIECES_OF, module.get_unique_name("do_pieces"))
    doer.linkage = "internal"
    builder = ir.IRBuilder(doer.append_basic_block())
    job = builder.inttoptr(doer.args[0], layout.as_pointer())
    kernel, count, pieces, arguments = (
        builder.load(_member(builder, job, k)) for k in (KERNEL, COUNT, PIECES, ARGUMENTS)
    )
    edges = [builder.sdiv(builder.mul(count, edge), pieces) for edge in doer.args[1:]]
    convention = context.call_conv
    callee = builder.inttoptr(kernel, convention.get_function_type(types.none, kinds).as_pointer())
    members = cgutils.unpack_tuple(builder, arguments)  # type: ignore[no-untyped-call]
    status, _ = convention.call_function(builder, callee, types.none, kinds, [*edges, *members])
    with builder.if_then(status.is_error, likely=False):
        code = builder.sext(status.code, WORD)
        noted = builder.cmpxchg(_member(builder, job, FAULT), WORD(0), code, "seq_cst")
        with builder.if_then(builder.extract_value(noted, 1)):
            builder.store(builder.ptrtoint(status.excinfoptr, WORD), _member(builder, job, INFO))
    builder.ret_void()
    return doer


def _member(builder: Any, job: Any, k: int) -> Any:
    return cgutils.gep_inbounds(builder, job, 0, k)  # type: ignore[no-untyped-call]


@instruction
def raise_fault(typing: Any, job: Any) -> Any:
    """Raise the exception of a piece of a job, if there was one; all pieces must be done."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = builder.inttoptr(args[0], WORD.as_pointer())
        code, info = (builder.load_atomic(builder.gep(words, [WORD(k)]), "seq_cst", 8) for k in (FAULT, INFO))
        convention = context.call_conv
        with builder.if_then(builder.icmp_signed("!=", code, WORD(0)), likely=False):
            info = builder.inttoptr(info, callconv.excinfo_ptr_t)
            status = convention._get_return_status(builder, builder.trunc(code, callconv.errcode_t), info)
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.void(types.int64), generate


@instruction
def assign(typing: Any, job: Any, kernel: Any) -> Any:
    """Give a job another kernel, which takes the same arguments."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = builder.inttoptr(args[0], WORD.as_pointer())
        builder.store(args[1], builder.gep(words, [WORD(KERNEL)]))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


@instruction
def do(typing: Any, doer: Any, job: Any, first: Any, end: Any) -> Any:
    """Do the pieces [first, end) of a job, by one call of its kernel."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.call(builder.inttoptr(args[0], PIECES_OF.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), generate


def c_function(name: str) -> int:
    """Return the address of a function of the C library."""
    return ctypes.cast(getattr(ctypes.CDLL(None), name), ctypes.c_void_p).value or 0


@instruction
def call(typing: Any, function: Any) -> Any:
    """Call the C function at an address, without arguments."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.call(builder.inttoptr(args[0], ir.FunctionType(ir.VoidType(), []).as_pointer()), [])
        return context.get_dummy_value()

    return types.void(types.int64), generate
