"""Results of benchmarks, by processor: `benchmarks/measurement.py`."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def measurement(tmp_path: Path) -> Any:
    spec = importlib.util.spec_from_file_location("measurement", BENCHMARKS / "measurement.py")
    assert spec is not None and spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.RESULTS = tmp_path
    return module


@pytest.mark.parametrize(
    "vendor, family, model, name, flags, expected",
    [
        ("AuthenticAMD", 25, 17, "AMD EPYC", "sse avx512f", "AMD Zen 4 (AVX-512)"),
        ("AuthenticAMD", 26, 2, "AMD EPYC", "sse avx512f", "AMD Zen 5 (AVX-512)"),
        ("AuthenticAMD", 25, 1, "AMD EPYC 7763 64-Core Processor", "avx2", "AMD Zen 3"),
        ("GenuineIntel", 6, 143, "Intel(R) Xeon(R) Processor", "avx512f", "Intel Xeon (AVX-512)"),
        ("GenuineIntel", 6, 158, "Intel(R) Core(TM) i7-8700 CPU @ 3.20GHz", "avx2", "Intel Core i7-8700"),
    ],
)
def test_a_processor_has_a_short_name(
    measurement: Any, vendor: str, family: int, model: int, name: str, flags: str, expected: str
) -> None:
    facts = {"vendor_id": vendor, "cpu family": str(family), "model": str(model), "model name": name, "flags": flags}
    assert measurement.processor_of(facts) == expected


def test_results_of_another_processor_stay(measurement: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, ms in (("one", 3.0), ("other", 5.0), ("one", 4.0)):
        monkeypatch.setattr(measurement, "processor", lambda name=name: name)
        measurement.merge("heap", {"rows": [{"bodies": 10, "ms": ms}]})
    kept = json.loads((tmp_path / "heap.json").read_text(encoding="utf-8"))
    assert {name: results["rows"] for name, results in kept.items()} == {
        "one": [{"bodies": 10, "ms": 4.0}],
        "other": [{"bodies": 10, "ms": 5.0}],
    }
