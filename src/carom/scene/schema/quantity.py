"""Types of the values of a scene: numbers within limits, vectors and sections."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

LARGEST = 1e100  # cubes and most products of numbers up to this are finite
SMALLEST = 1e-100


def _refuse_extremes(value: float) -> float:
    """Refuse numbers whose powers overflow or underflow; 0 is allowed."""
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"{value:g} is not between {SMALLEST:g} and {LARGEST:g} in size; choose other units")
    return value


_Sized = AfterValidator(_refuse_extremes)
AnyReal = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Real = Annotated[float, Field(strict=True, allow_inf_nan=False), _Sized]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0), _Sized]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0), _Sized]
Friction = Annotated[float, Field(strict=True, ge=0, le=LARGEST)]  # dimensionless, so units cannot change its size
Name = Annotated[str, Field(strict=True, min_length=1)]
MOST = 2**53  # largest count: a float represents each smaller whole number, and the counters of kernels can hold it
Count = Annotated[int, Field(strict=True, ge=1, lt=MOST)]
Vector = tuple[Real, Real, Real]
ORIGIN: Vector = (0.0, 0.0, 0.0)


class Section(BaseModel):
    """A table of the scene file: immutable; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=False)


class SectionError(ValueError):
    """A contradiction between sections, and the key to change."""

    def __init__(self, path: tuple[str | int, ...], message: str) -> None:
        super().__init__(message)
        self.path = path
