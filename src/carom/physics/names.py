"""What the two ends of a contact are called."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Names:
    """Names of the n bodies, and of the planes, whose indices follow."""

    bodies: list[str]
    planes: list[str]

    def of(self, end: int) -> str:
        """Name an end for people: ``body 3 "boulder"``, ``body 3`` if it has no other name, or a plane by its name."""
        if end < len(self.bodies):
            numbered, name = f"body {end}", self.bodies[end]
            return numbered if name in ("", numbered) else f'{numbered} "{name}"'
        return self.planes[end - len(self.bodies)]
