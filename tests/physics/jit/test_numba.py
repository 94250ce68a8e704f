"""What carom uses of Numba's inside, one test each: a new version that changes it fails here, by name.

Where a part is missing, kernels are plain (`test_plain.py`); only these tests find a part that has changed its meaning.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import ir
from numba import types
from numba.core import caching, callconv, cgutils, config, event, serialize
from numba.core.compiler import CompileResult, Flags
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from carom.physics.jit import inside
from carom.physics.jit.decorators import Compilations, QuickFlags, entry_of, kernel


def test_this_numba_has_every_part_that_is_used() -> None:
    assert inside.MISSING == []


def double(x: float) -> float:
    return 2.0 * x


class LockTimes(event.Listener):
    heard = 0

    def on_start(self, event: Any) -> None:
        self.heard += 1

    def on_end(self, event: Any) -> None:
        self.heard += 1


def test_numba_does_not_time_each_call_of_llvm() -> None:
    with event.install_listener("numba:llvm_lock", LockTimes()) as times:
        compiled: Any = numba.njit(lambda x: 3.0 * x)
        assert compiled(1.0) == 3.0
    assert times.heard == 0


@kernel
def root(values: Any, k: int) -> float:
    if values[k] < 0.0:
        raise ValueError("negative")
    return float(np.sqrt(values[k]))


@pytest.fixture(scope="module")
def compiled() -> Any:
    dispatcher: Any = numba.njit(double)
    dispatcher(1.0)
    return dispatcher


@pytest.fixture(scope="module")
def result(compiled: Any) -> Any:
    (found,) = compiled.overloads.values()
    return found


def test_the_entry_of_a_kernel_takes_its_arguments_and_raises_its_exceptions() -> None:
    entry = entry_of(root, np.full(3, 4.0), 1)
    assert entry(np.full(2, 9.0), 1) == 3.0
    with pytest.raises(ValueError, match="negative"):
        entry(np.full(2, -9.0), 0)


def test_a_dispatcher_without_a_cache_has_one_that_does_nothing_to_put_ours_in_its_place(compiled: Any) -> None:
    assert isinstance(compiled, Dispatcher)
    assert isinstance(vars(compiled)["_cache"], caching.NullCache)


def test_a_cache_is_asked_for_a_signature_and_handed_what_was_compiled() -> None:
    asked: list[tuple[Any, ...]] = []

    class Cache(caching.NullCache):
        def load_overload(self, *arguments: Any) -> None:
            asked.append(arguments)

        def save_overload(self, *arguments: Any) -> None:
            asked.append(arguments)

    dispatcher: Any = numba.njit(double)
    dispatcher._cache = Cache()
    assert dispatcher(2.0) == 4.0
    (sig, context), (again, compiled) = asked
    assert sig == again and context is dispatcher.targetctx and isinstance(compiled, CompileResult)


def test_a_result_is_taken_apart_and_put_together_again(compiled: Any, result: Any) -> None:
    compiled.targetctx.refresh()
    data = serialize.dumps(result._reduce())  # type: ignore[no-untyped-call]
    assert isinstance(data, bytes)
    rebuild: Any = CompileResult._rebuild
    assert rebuild(compiled.targetctx, *result._reduce()).signature == result.signature


def test_a_result_says_whether_it_holds_for_this_process_only(result: Any) -> None:
    assert result.library.has_dynamic_globals is False and not result.lifted


def test_code_says_for_which_processor_it_is(compiled: Any, result: Any) -> None:
    triple, processor, features = compiled.targetctx.codegen().magic_tuple()
    assert all(isinstance(part, str) for part in (triple, processor, features))
    assert result.codegen.magic_tuple() == (triple, processor, features)


@pytest.mark.parametrize("writeable", [True, False])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", [np.float64, np.int64, np.dtype([("x", "f8"), ("y", "i8")])])
def test_types_are_written_alike_only_if_they_are_the_same(writeable: bool, order: Any, kind: Any) -> None:
    array = np.zeros((2, 2), dtype=kind, order=order)
    array.flags.writeable = writeable
    plain = np.zeros((2, 2), dtype=np.float64)
    is_same = writeable and order == "C" and kind is np.float64
    assert (repr(numba.typeof(array)) == repr(numba.typeof(plain))) == is_same  # type: ignore[no-untyped-call]


def test_a_dispatcher_finds_what_a_kernel_calls_by_one_method() -> None:
    inner: Any = numba.njit(double)
    asked: list[Any] = []
    find = inner.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        asked.append(args)
        return find(args, kws)

    inner.get_call_template = get_call_template

    def call(x: float) -> Any:
        return inner(x)

    outer: Any = numba.njit(call)
    assert outer(1.0) == 2.0 and asked


def test_compilations_are_told_as_events() -> None:
    assert issubclass(Compilations, event.Listener)
    dispatcher: Any = numba.njit(double)
    with Compilations() as compilations:
        dispatcher(1.0)
        dispatcher(2.0)
    assert compilations.count == 1


def test_the_address_of_compiled_code_can_be_asked(result: Any) -> None:
    assert result.library.get_pointer_to_function(result.fndesc.llvm_func_name) > 0


def test_compiled_code_is_found_by_the_types_of_its_arguments(compiled: Any) -> None:
    (found,) = compiled.overloads.values()
    assert found.signature.args == (types.float64,)


def test_a_kernel_that_only_kernels_call_needs_no_wrapper() -> None:
    options: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, "nogil": True}
    compile_as: Any = numba.njit  # whose stub does not know all options
    inner = compile_as(no_cpython_wrapper=True, **options)(double)
    inlined = compile_as(inline="always", **options)(double)

    def call(x: float) -> Any:
        return inner(x) / inlined(0.0)

    assert compile_as(**options)(call)(1.0) == np.inf, "as NumPy divides by zero"
    assert inner.targetoptions["no_cpython_wrapper"] is inner.targetoptions["no_cfunc_wrapper"] is True


def test_the_type_of_a_literal_can_be_widened() -> None:
    unliteral: Any = types.unliteral
    assert unliteral(numba.typeof(1)) == unliteral(types.literal(1)) == types.int64  # type: ignore[no-untyped-call]


@intrinsic
def exchange(typing: Any, words: Any, word: Any, expected: Any, value: Any) -> Any:
    """Take the address of an element and change it, as `carom.physics.jit.instructions` does."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        view = context.make_array(words)(context, builder, args[0])
        address: Any = cgutils.get_item_pointer(  # type: ignore[no-untyped-call]
            context, builder, words, view, [args[1]]
        )
        builder.cmpxchg(address, args[2], args[3], "seq_cst")
        builder.atomic_rmw("add", address, args[3], "seq_cst")
        word = builder.load_atomic(address, "seq_cst", 8)
        builder.store_atomic(builder.add(word, word), address, "seq_cst", 8)
        members = [builder.ptrtoint(address, ir.IntType(64)), word]
        return context.make_tuple(builder, signature.return_type, members)

    pair: Any = types.UniTuple
    return pair(types.int64, 2)(words, types.intp, types.int64, types.int64), generate


def test_an_intrinsic_takes_the_address_of_an_element_and_changes_it_at_once() -> None:
    change: Any = exchange  # Numba fills in its first argument

    def call(words: Any) -> Any:
        return change(words, 1, 7, 20)

    words = np.array([3, 7, 5])
    outer: Any = numba.njit(call)
    assert outer(words) == (words.ctypes.data + words.itemsize, 40)
    assert words.tolist() == [3, 80, 5]


@intrinsic
def call_by_address(typing: Any, address: Any, arguments: Any) -> Any:
    """Call a kernel as `carom.physics.jit.task` does, with the members of a tuple in memory; pass on what it raises."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        untyped: Any = cgutils
        layout = ir.LiteralStructType([context.get_value_type(arguments)])
        place = untyped.alloca_once(builder, layout)
        builder.store(args[1], untyped.gep_inbounds(builder, place, 0, 0))
        members = untyped.unpack_tuple(builder, builder.load(untyped.gep_inbounds(builder, place, 0, 0)))
        convention, kinds = context.call_conv, tuple(arguments)
        kernel = builder.inttoptr(args[0], convention.get_function_type(types.none, kinds).as_pointer())
        status, _ = convention.call_function(builder, kernel, types.none, kinds, members)
        with builder.if_then(status.is_error):
            code = builder.trunc(builder.sext(status.code, ir.IntType(64)), callconv.errcode_t)
            info = builder.inttoptr(builder.ptrtoint(status.excinfoptr, ir.IntType(64)), callconv.excinfo_ptr_t)
            convention.return_status_propagate(builder, convention._get_return_status(builder, code, info))
        return context.get_dummy_value()

    return types.void(types.int64, arguments), generate


def test_code_at_an_address_is_called_and_what_it_raises_is_passed_on() -> None:
    def fill(places: Any, value: float) -> None:
        if value < 0.0:
            raise ValueError("negative", value)
        places[0] = value

    filling: Any = numba.njit(fill)
    filling(np.zeros(1), 1.0)
    (found,) = filling.overloads.values()
    address = found.library.get_pointer_to_function(found.fndesc.llvm_func_name)

    call_it: Any = call_by_address  # Numba fills in its first argument

    def call(address: int, arguments: Any) -> None:
        call_it(address, arguments)

    outer, places = numba.njit(call), np.zeros(1)
    outer(address, (places, 3.0))
    assert places[0] == 3.0
    with pytest.raises(ValueError, match=r"negative.*-2\.0"):
        outer(address, (places, -2.0))


def test_the_folder_that_the_environment_names_is_in_the_configuration() -> None:
    assert isinstance(vars(config)["CACHE_DIR"], str)


def options(**given: Any) -> tuple[Any, Any]:
    """Return Numba's options of a compilation and ours, with the same values."""
    make_plain: Any = Flags  # without types, like all of Numba's inside
    make_quick: Any = QuickFlags
    plain = make_plain()
    for name, value in given.items():
        setattr(plain, name, value)
    return plain, make_quick(plain)


def test_quick_options_are_equal_where_those_of_numba_are() -> None:
    default, quick_default = options()
    plain, quick = options(error_model="numpy", release_gil=True)
    explicit, quick_explicit = options(release_gil=False)
    assert quick == plain and plain == quick and quick not in (quick_default, default)
    assert quick_default == quick_explicit and default == explicit
    assert quick.values() == plain.values()
    assert len({hash(found) for found in (default, quick_default, plain, quick, explicit, quick_explicit)}) == 1


def test_a_kernel_is_compiled_with_quick_options() -> None:
    seen: list[Any] = []

    class Seen(numba.core.compiler.Compiler):
        def define_pipelines(self) -> Any:
            seen.append(type(self.state.flags))
            return super().define_pipelines()  # type: ignore[no-untyped-call]

    compile_as: Any = numba.njit
    dispatcher: Any = compile_as(pipeline_class=Seen)(double)
    dispatcher._compiler._customize_flags = QuickFlags
    assert dispatcher(1.0) == 2.0
    assert seen == [QuickFlags]
