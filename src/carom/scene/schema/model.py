"""[model]: parts to model even though the scene does not require them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, field_validator

from carom.scene.parts import PARTS, unknown
from carom.scene.schema.quantity import Section


def _one_as_several(value: Any) -> Any:
    """Read a single name as a list of one."""
    return [value] if isinstance(value, str) else value


class Model(Section):
    """[model]: parts to model even though the scene does not require them."""

    force: Annotated[tuple[Annotated[str, Field(strict=True)], ...], BeforeValidator(_one_as_several)] = Field(
        (), description="parts to switch on, by the names that `carom explain` prints; one, or a list"
    )

    @field_validator("force")
    @classmethod
    def _parts_are_known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in PARTS:
                raise ValueError(unknown(name))
        return names
