"""[[wall]]: walls of other shapes than planes."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field, model_validator

from carom.scene.schema.contact import Surface
from carom.scene.schema.motion import WallMotion
from carom.scene.wall_shapes import shape_called

KNOWN_SHAPES: list[str] = []  # shapes that have a section; see `know_installed_parts`


class Wall(Surface):
    """[[wall]]: a wall with the section of its shape.

    Its coefficients apply to all contacts with it; missing ones are combined from both materials.
    """

    name: str = Field("", description="shown in warnings")
    material: str | None = Field(None, description="name of a [[material]], in place of coefficients")
    motion: WallMotion | None = Field(None, description="a prescribed motion; at rest by default")

    @property
    def shapes(self) -> list[str]:
        """The shapes for which the wall has a section."""
        return [name for name in KNOWN_SHAPES if getattr(self, name, None) is not None]

    @property
    def shape(self) -> str:
        """The name of the wall's shape."""
        return self.shapes[0]

    @property
    def section(self) -> Any:
        """The section of the wall's shape."""
        return getattr(self, self.shape)

    @property
    def moves(self) -> bool:
        """Whether the wall's surface moves."""
        return self.motion is not None and self.motion.moves

    @property
    def translates(self) -> bool:
        """Whether the wall changes its place."""
        return self.motion is not None and self.motion.translates

    @model_validator(mode="after")
    def _has_one_shape(self) -> Self:
        if not self.shapes:
            raise ValueError(f"has no shape; add the section of one: {', '.join(KNOWN_SHAPES)}")
        if len(self.shapes) > 1:
            raise ValueError(f"has the shapes {' and '.join(self.shapes)}; leave all but one out")
        if self.motion is not None and self.motion.rotation and shape_called(self.shape).axis is None:
            raise ValueError(
                f"motion.rotation of a {self.shape}, which has no axis about which its surface moves along itself; use "
                "a cylinder, cone, disc or sphere, or remove the rotation"
            )
        return self
