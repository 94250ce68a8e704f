"""The contacts of a step with their colours, in the order in which they are solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from carom.arrays import IntArray
from carom.physics.bodies import Bodies
from carom.physics.contact.constraint_graph import OVERFLOW, colour_bodies, colour_contacts
from carom.physics.contact.solve_order import SolveOrder, solve_order_of


@dataclass(frozen=True, slots=True)
class OrderedContacts:
    """Contacts by pair, and where each stands in the order of the solver."""

    pairs: IntArray  # (m, 2), sorted; j ≥ n is plane j - n
    colours: IntArray  # (m,)
    body_colours: IntArray | None  # as in `CollisionGraph`
    order: SolveOrder

    @classmethod
    def of(cls, pairs: IntArray, bodies: Bodies, colouring: str) -> Self:
        """Colour contacts as `contact.colouring` says."""
        if colouring == "bodies":
            colours, body_colours = colour_bodies(pairs, len(bodies))
            return cls(pairs, colours, body_colours, solve_order_of(pairs, colours, independent=False))
        colours = colour_contacts(pairs, bodies.ends.inverse_mass)
        return cls(pairs, colours, None, solve_order_of(pairs, colours))

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def overflows(self) -> bool:
        """Whether some contacts have the colour `OVERFLOW` and are solved one by one."""
        return self.body_colours is None and self.order.count > OVERFLOW
