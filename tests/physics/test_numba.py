"""What carom uses of Numba's inside, one test each: a new version that changes it fails here, by name."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from numba.core import caching, config, event, serialize
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher

from carom.physics.parallel.jit import Compilations


def double(x: float) -> float:
    return 2.0 * x


@pytest.fixture(scope="module")
def compiled() -> Any:
    dispatcher: Any = numba.njit(double)
    dispatcher(1.0)
    return dispatcher


@pytest.fixture(scope="module")
def result(compiled: Any) -> Any:
    (found,) = compiled.overloads.values()
    return found


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


def test_a_cache_must_define_what_ours_does() -> None:
    needed = {"cache_path", "load_overload", "save_overload", "enable", "disable", "flush"}
    assert caching._Cache.__abstractmethods__ == needed


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


def test_the_folder_that_the_environment_names_is_in_the_configuration() -> None:
    assert isinstance(vars(config)["CACHE_DIR"], str)
