"""Names of bodies and planes in messages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the n bodies and of the planes, whose indices follow those of the bodies."""

    bodies: list[str]
    planes: list[str]

    def of(self, end: int) -> str:
        """Return a name such as ``body 3 "boulder"``, ``body 3`` if the body has no name, or the name of a plane."""
        if end < len(self.bodies):
            numbered, name = f"body {end}", self.bodies[end]
            return numbered if name in ("", numbered) else f'{numbered} "{name}"'
        return self.planes[end - len(self.bodies)]
