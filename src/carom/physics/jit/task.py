"""A kernel and its arguments as two addresses, so that any thread can do a piece of the work without the interpreter.

A helper that calls the kernel through the interpreter waits for the interpreter lock: 10 to 30 µs for half a dozen
pieces. In this way, a step of 10⁴ bodies gained a factor of 1.2 from a second thread; with addresses, 1.65. Numba can
pass a kernel to another kernel as a value, but then compiles the receiving kernel again for each passed kernel and each
set of arguments. The phases of the contact solver, called by name, would all be compiled into each of their callers.

In the plain form, a task is a Python object that calls its kernel; the functions that lead tasks (`leading`) are then
Python as well.
"""

from __future__ import annotations

import ctypes
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np

from carom.physics.jit.by_address import Located, unchanged
from carom.physics.jit.decorators import Function
from carom.physics.jit.inside import PLAIN, callconv, cgutils, ir, types
from carom.physics.jit.instructions import WORD, Code, instruction

# types of a kernel's arguments: address of the job, first piece, end of the pieces
PIECES_OF = ir.FunctionType(ir.VoidType(), [WORD, WORD, WORD])
FAULT, INFO, KERNEL, COUNT, PIECES, ARGUMENTS = range(6)  # words of a job; FAULT: error code (0: none), INFO: exception
CODE: Any = np.object_ if PLAIN else np.int64  # type of the elements in arrays of results of `code_for`


def leading(compile_as: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Compile a function that calls kernels as tasks, but leave it to Python if kernels are plain."""
    return (lambda function: function) if PLAIN else compile_as


# prepares records for `leading` functions, which read fields as attributes
led: Callable[[Any], Any] = (lambda records: records.view(np.recarray)) if PLAIN else unchanged


class PlainJob:
    """A kernel to be called on [0, count), divided into pieces."""

    def __init__(self, kernel: Callable[..., None] | int, count: int, pieces: int, arguments: tuple[Any, ...]) -> None:
        self.kernel: Any = kernel
        self._count, self._pieces, self._arguments = count, pieces, arguments

    def do(self, first: int, end: int) -> None:
        """Do the pieces [first, end)."""
        edges = (self._count * piece // self._pieces for piece in (first, end))
        self.kernel(*edges, *self._arguments)


def address_of(kernel: Callable[..., None], kind: int) -> int:
    """Return the address of a kernel's machine code for (lo, hi, *arguments), given their kind (`kind_of`)."""
    for compiled in kernel.overloads.values():  # type: ignore[attr-defined]
        if _kind(compiled.signature.args[2:]) == kind:
            address: int = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
            return address
    raise TypeError(f"{kernel} has never been called with such arguments")


def code_for(kernel: Callable[..., None], fields: tuple[Any, ...]) -> Any:
    """Compile a kernel for (lo, hi, a located tuple), or load it; return the address of its machine code.

    In the plain form, the result is the kernel itself.
    """
    if PLAIN:
        return kernel
    compiled: Any = kernel
    type_of: Any = numba.typeof
    compiled.compile((types.int64, types.int64, Located(type_of(fields))))
    return address_of(kernel, kind_for(fields))


def kind_for(fields: tuple[Any, ...]) -> int:
    """Return the result of `kind_of` for a located tuple; for use outside of kernels."""
    type_of: Any = numba.typeof
    return _kind([Located(type_of(fields))])


def _kind(kinds: Sequence[Any]) -> int:
    return 0 if PLAIN else zlib.crc32(repr(tuple(kinds)).encode()) + 1


@instruction(lambda arguments: 0, returns="int64")
def kind_of(code: Code, arguments: Any) -> Any:
    """Return a nonzero number that identifies the types of a tuple's members."""
    return WORD(_kind(list(code.kinds["arguments"])))


@instruction(
    lambda kernel, count, pieces, arguments: (0, PlainJob(kernel, count, pieces, arguments)),
    returns=("int64", "int64"),
    kernel="int64",
    count="int64",
    pieces="int64",
)
def lay_out(code: Code, kernel: Any, count: Any, pieces: Any, arguments: Any) -> list[Any]:
    """Lay out a job, valid until the caller returns: a kernel to be called on [0, count), divided into pieces.

    Return the addresses of the function that processes pieces of such a job, and of the job.
    """
    kinds = (types.int64, types.int64, *code.kinds["arguments"])
    layout = ir.LiteralStructType([WORD] * ARGUMENTS + [code.context.get_value_type(code.kinds["arguments"])])
    job = cgutils.alloca_once(code.builder, layout)
    for k, value in enumerate((WORD(0), WORD(0), kernel, count, pieces, arguments)):
        code.builder.store(value, _member(code.builder, job, k))
    doer = _doer(code.context, code.builder.module, layout, kinds)
    return [code.builder.ptrtoint(pointer, WORD) for pointer in (doer, job)]


def _doer(context: Any, module: Any, layout: Any, kinds: Sequence[Any]) -> Any:
    """Write the function that calls the kernel of a job for some pieces.

    The function stores a job's first exception in the job, for `raise_fault`.
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
    members = cgutils.unpack_tuple(builder, arguments)
    status, _ = convention.call_function(builder, callee, types.none, kinds, [*edges, *members])
    with builder.if_then(status.is_error, likely=False):
        code = builder.sext(status.code, WORD)
        noted = builder.cmpxchg(_member(builder, job, FAULT), WORD(0), code, "seq_cst")
        with builder.if_then(builder.extract_value(noted, 1)):
            builder.store(builder.ptrtoint(status.excinfoptr, WORD), _member(builder, job, INFO))
    builder.ret_void()
    return doer


def _member(builder: Any, job: Any, k: int) -> Any:
    return cgutils.gep_inbounds(builder, job, 0, k)


@instruction(lambda job: None, job="int64")
def raise_fault(code: Code, job: Any) -> None:
    """Raise the exception of a job's pieces, if there was one; all pieces must be done."""
    builder, convention = code.builder, code.context.call_conv
    words = builder.inttoptr(job, WORD.as_pointer())
    fault, info = (builder.load_atomic(builder.gep(words, [WORD(k)]), "seq_cst", 8) for k in (FAULT, INFO))
    with builder.if_then(builder.icmp_signed("!=", fault, WORD(0)), likely=False):
        info = builder.inttoptr(info, callconv.excinfo_ptr_t)
        status = convention._get_return_status(builder, builder.trunc(fault, callconv.errcode_t), info)
        convention.return_status_propagate(builder, status)


@instruction(lambda job, kernel: setattr(job, "kernel", kernel), job="int64", kernel="int64")
def assign(code: Code, job: Any, kernel: Any) -> None:
    """Give a job another kernel that takes the same arguments."""
    words = code.builder.inttoptr(job, WORD.as_pointer())
    code.builder.store(kernel, code.builder.gep(words, [WORD(KERNEL)]))


@instruction(lambda doer, job, first, end: job.do(first, end), doer="int64", job="int64", first="int64", end="int64")
def do(code: Code, doer: Any, job: Any, first: Any, end: Any) -> None:
    """Do the pieces [first, end) of a job, by one call of its kernel."""
    code.builder.call(code.builder.inttoptr(doer, PIECES_OF.as_pointer()), [job, first, end])


def c_function(name: str) -> int:
    """Return the address of a function of the C library."""
    return ctypes.cast(getattr(ctypes.CDLL(None), name), ctypes.c_void_p).value or 0


@instruction(lambda function: None, function="int64")
def call(code: Code, function: Any) -> None:
    """Call the C function at an address, without arguments."""
    code.builder.call(code.builder.inttoptr(function, ir.FunctionType(ir.VoidType(), []).as_pointer()), [])
