"""The dimensions of the quantities in a scene and in the output of carom, each with its SI unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

BASE = ("length", "time", "mass", "angle")

_QUANTITY = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\D"  # a number and the beginning of a unit

Exponents = tuple[int, int, int, int]  # powers of the dimensions in `BASE`


@dataclass(frozen=True, slots=True)
class Dimension:
    """A dimension, such as energy."""

    name: str
    unit: str  # SI unit, as it is printed and accepted in texts
    exponents: Exponents
    example: str  # a quantity, as a person writes it
    plain: str = ""  # the key of [units] that sets its unit; empty for a derived unit

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        """Describe a quantity in the JSON schema: a text with a unit may replace each number."""
        return self._or_text(handler(core))

    def _or_text(self, schema: dict[str, Any]) -> dict[str, Any]:
        if "prefixItems" in schema:
            return {**schema, "prefixItems": [self._or_text(number) for number in schema["prefixItems"]]}
        text = {"type": "string", "pattern": _QUANTITY, "examples": [self.example]}
        return {"anyOf": [schema, *([{"type": "number"}] if "$ref" in schema else []), text]}

    @property
    def called(self) -> str:
        """The name with its article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


LENGTH = Dimension("length", "m", (1, 0, 0, 0), "3 km", "length")
TIME = Dimension("time", "s", (0, 1, 0, 0), "12 h", "time")
MASS = Dimension("mass", "kg", (0, 0, 1, 0), "5 t", "mass")
ANGLE = Dimension("angle", "rad", (0, 0, 0, 1), "30 deg", "angle")
VELOCITY = Dimension("velocity", "m/s", (1, -1, 0, 0), "2 km/s", "velocity")
ACCELERATION = Dimension("acceleration", "m/s²", (1, -2, 0, 0), "9.81 m/s^2", "acceleration")
ANGULAR_VELOCITY = Dimension("angular velocity", "rad/s", (0, -1, 0, 1), "10 deg/s", "angular_velocity")
DENSITY = Dimension("density", "kg/m³", (-3, 0, 1, 0), "5 g/cm^3", "density")
GRAVITATIONAL_CONSTANT = Dimension(
    "gravitational constant", "m³ kg⁻¹ s⁻²", (3, -2, -1, 0), "4.3e-3 pc (km/s)^2 / solar mass"
)
RATE = Dimension("rate", "1/s", (0, -1, 0, 0), "50 Hz")
IMPULSE = Dimension("impulse", "N s", (1, -1, 1, 0), "3 N s")
ANGULAR_IMPULSE = Dimension("angular impulse", "N m s", (2, -1, 1, 0), "3 N m s")
FORCE = Dimension("force", "N", (1, -2, 1, 0), "3 N")
TORQUE = Dimension("torque", "N m", (2, -2, 1, 0), "3 N m")
ANGULAR_ACCELERATION = Dimension("angular acceleration", "rad/s²", (0, -2, 0, 1), "3 rad/s^2")
ENERGY = Dimension("energy", "J", (2, -2, 1, 0), "3 kJ", "energy")

DIMENSIONS: Sequence[Dimension] = (
    LENGTH,
    TIME,
    MASS,
    ANGLE,
    VELOCITY,
    ACCELERATION,
    ANGULAR_VELOCITY,
    DENSITY,
    GRAVITATIONAL_CONSTANT,
    RATE,
    IMPULSE,
    ANGULAR_IMPULSE,
    FORCE,
    TORQUE,
    ANGULAR_ACCELERATION,
    ENERGY,
)
NAMED = {dimension.plain: dimension for dimension in DIMENSIONS if dimension.plain}  # by the key of [units]
OF_UNIT = {dimension.unit: dimension for dimension in DIMENSIONS}  # by SI unit
# torque is excluded: it has the exponents of an energy
OF_EXPONENTS = {dimension.exponents: dimension for dimension in DIMENSIONS}
