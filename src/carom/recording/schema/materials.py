"""The materials of the bodies, as a recording shows them: names, colours, and the coefficients of their contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.recording.schema import palette
from carom.scene.matter import KindOfContact, body_materials, kinds_of_contacts, material_called
from carom.scene.schema import Scene

Colours = NDArray[np.uint32]


@dataclass(frozen=True)
class ShownMaterials:
    """Materials of a scene that has any."""

    names: list[str]  # (a,) of the materials that bodies have
    colours: list[int]  # (a,) 0xRRGGBBAA
    index: NDArray[np.int64]  # (n,) the material of each body
    has_colours: bool  # whether the scene gives a material a colour
    contacts: list[KindOfContact]

    @classmethod
    def of(cls, scene: Scene) -> ShownMaterials | None:
        """Return the materials of a scene; None if it has none but that of [contact]."""
        if not scene.material:
            return None
        found = body_materials(scene)
        known = [material_called(scene, name) for name in found.names]
        given = [material.colour if material else None for material in known]
        contacts = kinds_of_contacts(scene)
        return cls(found.names, palette.material_colours(given), found.index, any(given), contacts)

    def body_colours(self) -> Colours:
        """Return the colour of each body, (n,)."""
        return np.array(self.colours, dtype=np.uint32)[self.index]

    @property
    def described(self) -> list[dict[str, Any]]:
        """Each material, how many bodies have it, and what they may touch, as `carom inspect --json` prints it."""
        count = np.bincount(self.index, minlength=len(self.names)).tolist()
        return [
            {
                "name": name,
                "bodies": bodies,
                "colour": palette.name_of(colour),
                "contacts": {kind.other(name): kind.coefficients._asdict() for kind in self._of(name)},
            }
            for name, bodies, colour in zip(self.names, count, self.colours, strict=True)
        ]

    def _of(self, name: str) -> list[KindOfContact]:
        """Return the kinds of contacts of a material."""
        return [kind for kind in self.contacts if name in kind.between]
