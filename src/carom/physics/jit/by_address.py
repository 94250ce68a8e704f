"""Named tuples passed to kernels by address.

Numba passes a tuple of arrays as about seven words for each array. The contacts of a step are 200 words, and a kernel
of many steps would copy them for each of the forty functions of a step. With three bodies, the copies take more than
half of the kernel's time. A located tuple is one word. Kernels read its fields like the fields of the tuple itself, and
each function reads only the fields that it uses.

In the plain form, a located tuple is the tuple itself.
"""

from __future__ import annotations

from typing import Any

from carom.physics.jit.decorators import inline
from carom.physics.jit.inside import cgutils, extending, imputils, ir, templates, types
from carom.physics.jit.instructions import Code, instruction

BYTES = ir.IntType(8).as_pointer()


class Located(types.Type):  # type: ignore[misc] # untyped, like Numba's internals
    """Numba's type for the address of a named tuple in memory that does not change."""

    def __init__(self, of: Any) -> None:
        self.of = of  # type of the tuple
        self.fields, self.types = of.fields, of.types  # names and types of its members
        super().__init__(f"Located({of})")

    def member(self, field: str) -> Any:
        """Return the type of a field; tuples in the tuple are also located."""
        kind = self.types[self.fields.index(field)]
        return Located(kind) if hasattr(kind, "fields") else kind


extending.register_model(Located)(extending.models.OpaqueModel)


@templates.infer_getattr
class _LocatedFields(templates.AttributeTemplate):  # type: ignore[misc] # untyped, like Numba's internals
    key = Located

    def generic_resolve(self, kind: Any, field: str) -> Any:
        return kind.member(field) if field in kind.fields else None


def field_of(context: Any, builder: Any, kind: Any, address: Any, field: str) -> Any:
    """Generate code to read a field of a located tuple, or the address of a tuple in it."""
    layout = context.get_value_type(kind.of)
    place = cgutils.gep_inbounds(builder, builder.bitcast(address, layout.as_pointer()), 0, kind.fields.index(field))
    if isinstance(kind.member(field), Located):
        return builder.bitcast(place, BYTES)
    value = builder.load(place)
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


@extending.lower_getattr_generic(Located)
def _read(context: Any, builder: Any, kind: Any, address: Any, field: str) -> Any:
    value = field_of(context, builder, kind, address, field)
    return imputils.impl_ret_borrowed(context, builder, kind.member(field), value)


@inline
def unchanged(argument: Any) -> Any:
    """Return the argument; the plain form of conversions in kernels."""
    return argument


def _located(known: dict[str, Any]) -> Any:
    fields = known["fields"]
    return Located(fields) if hasattr(fields, "fields") else fields


@instruction(unchanged, returns=_located)
def by_address(code: Code, fields: Any) -> Any:
    """Return a named tuple as a located tuple, valid until the caller returns; an empty tuple is returned as it is.

    An empty piece of assembly hides where the address comes from. Without this assembly, LLVM might read fields before
    they are stored, since it sees no code that writes them.
    """
    if not hasattr(code.kinds["fields"], "fields"):
        return fields
    builder = code.builder
    place = builder.bitcast(cgutils.alloca_once_value(builder, fields), BYTES)
    return builder.asm(ir.FunctionType(BYTES, [BYTES]), "", "=r,0,~{memory}", [place], side_effect=True)
