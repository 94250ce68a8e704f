"""The results of a statistic: numbers with their errors, histograms and rows of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from carom.arrays import FloatArray
from carom.scene.units.dimension import Dimension
from carom.scene.units.system import UnitSystem

NUMBER = Dimension("number", "", (0, 0, 0, 0), "3")
MOST_BINS = 40  # largest number of bins of a histogram
TAIL = 0.995  # fraction of the values that a histogram shows; the largest values would stretch the axis


@dataclass(frozen=True)
class MeasuredValue:
    """A number, a vector or a matrix."""

    label: str
    value: int | float | FloatArray
    dimension: Dimension = NUMBER
    error: float | None = None  # one standard error; None if it is not known

    def document(self, units: UnitSystem) -> dict[str, Any]:
        """Return the result as JSON, in the units of the recording."""
        value = self.value.tolist() if isinstance(self.value, np.ndarray) else self.value
        return {"value": value, "error": self.error, "unit": units.recorded_unit(self.dimension.unit or "1")}


@dataclass(frozen=True)
class Histogram:
    """The distribution of a quantity, or a function of a distance, as values between edges."""

    label: str  # label of the quantity at the edges
    edges: FloatArray  # (b + 1,)
    values: FloatArray  # (b,) density of the distribution in 1/dimension, or values of the function
    dimension: Dimension = NUMBER  # dimension of the edges
    function: str = ""  # label of the function; empty for a density
    expected: FloatArray | None = None  # (b,) values of the theory
    theory: str = ""  # the name of the theory
    falls: bool = False  # whether values decay roughly exponentially, for a logarithmic axis in a figure

    @classmethod
    def of(cls, label: str, values: FloatArray, dimension: Dimension = NUMBER, *, falls: bool = False) -> Histogram:
        """Return the density of values, from 0 to the largest values shown."""
        high = float(np.quantile(values, TAIL)) if len(values) else 1.0
        bins = max(1, min(MOST_BINS, round(2 * len(values) ** (1 / 3))))  # Rice's rule
        edges = np.linspace(0.0, high if high > 0.0 else 1.0, bins + 1)
        counts = np.histogram(values, edges)[0]
        return cls(label, edges, counts / (max(1, len(values)) * np.diff(edges)), dimension, falls=falls)

    def document(self, units: UnitSystem) -> dict[str, Any]:
        """Return the result as JSON, in the units of the recording."""
        values = "values" if self.function else "density"
        theory = {} if self.expected is None else {"expected": self.expected.tolist(), "theory": self.theory}
        unit = units.recorded_unit(self.dimension.unit or "1")
        return {"edges": self.edges.tolist(), values: self.values.tolist(), **theory, "unit": unit}


@dataclass(frozen=True)
class Statistic:
    """All results of one kind of statistic."""

    values: Mapping[str, MeasuredValue] = field(default_factory=dict)
    histograms: Mapping[str, Histogram] = field(default_factory=dict)
    rows: Sequence[Mapping[str, Any]] = ()  # rows of a table, whose values are texts or `MeasuredValue`
    note: str = ""  # a sentence about the limits of the values
    missing: str = ""  # a sentence with the reason why there are no values

    def document(self, units: UnitSystem) -> dict[str, Any]:
        """Return the result as JSON, in the units of the recording."""
        if self.missing:
            return {"missing": self.missing}
        document: dict[str, Any] = {name: value.document(units) for name, value in self.values.items()}
        document |= {name: histogram.document(units) for name, histogram in self.histograms.items()}
        if self.rows:
            document["rows"] = [
                {key: v.document(units) if isinstance(v, MeasuredValue) else v for key, v in row.items()}
                for row in self.rows
            ]
        return document | ({"note": self.note} if self.note else {})
