"""A block: eight contacts of a colour that share no moving body, for code generators of phases.

The generated code performs the computations of the phase's loop in lanes, one per contact, with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from carom.physics.contact.constraints import SETTINGS, ConstraintSystem
from carom.physics.jit.by_address import field_of
from carom.physics.jit.decorators import inline
from carom.physics.jit.instructions import AHEAD, Code, fetch_line
from carom.physics.jit.vectors import (
    BYTE,
    DOUBLE,
    NOTHING,
    WIDTH,
    WORD,
    Lanes,
    Mask,
    RecordLanes,
    at_least,
    gathered,
    read_flags,
    spread,
)

VELOCITY, CHANGE = range(2)  # numbers of the cache lines of a body's record


@inline
def whole_blocks(piece: int, system: ConstraintSystem) -> int:
    """Return the number of whole blocks in a piece; 0 if its contacts may share moving bodies."""
    independent = piece < system.edges[system.settings[0].independent]
    return (system.pieces[piece, 1] - system.pieces[piece, 0]) // WIDTH if independent else 0


class Block:
    """Eight contacts of a `ConstraintSystem`.

    Parameters
    ----------
    code
        The instruction, whose argument is ``system``.
    first
        Index of the first contact, as a value in the generated code.
    """

    def __init__(self, code: Code, first: Any) -> None:
        self.code, self.builder = code, code.builder
        self._kind, self._system = code.kinds["system"], code.values["system"]
        self.places = [self.builder.add(first, WORD(k)) for k in range(WIDTH)]
        self.ends = self._ends_from(first)
        self.nothing = spread(self.builder, NOTHING)

    def kind_of(self, name: str) -> Any:
        """Return Numba's type of an array of the system."""
        return self._kind.member(name)

    def _array(self, name: str) -> Any:
        """Return the value of an array of the system."""
        return field_of(self.code.context, self.builder, self._kind, self._system, name)

    def count(self, name: str) -> Any:
        """Return the number of rows of an array of the system."""
        return self.code.length_of(self.kind_of(name), self._array(name))

    @property
    def body_count(self) -> Any:
        """The number of bodies; ends from this number on are planes."""
        return self.builder.sub(self.count("bodies"), self.count("surface"))

    def address(self, name: str, *indices: Any) -> Any:
        """Return the address of an element of a system's array."""
        return self.code.element_of(self.kind_of(name), self._array(name), *indices)

    def setting(self, name: str) -> Lanes:
        """Return a floating-point setting, in all lanes."""
        return spread(self.builder, self.builder.load(self._setting_at(name, DOUBLE)))

    def number(self, name: str) -> Any:
        """Return an integer setting."""
        return self.builder.load(self._setting_at(name, WORD))

    @property
    def drifts(self) -> Any:
        """A bit: whether a drift follows."""
        return self.builder.fcmp_ordered(">", self.setting("drift").lane(0), DOUBLE(0.0))

    @property
    def between_bodies(self) -> Mask:
        """The contacts with no plane as an end."""
        return ~at_least(self.builder, self.ends[1], self.body_count)

    @property
    def held(self) -> Mask:
        """The contacts that are held."""
        return read_flags(self.builder, self.address("held", self.places[0]))

    def records(self, name: str, kind: np.dtype[np.void], lines: Sequence[int]) -> RecordLanes:
        """Return the records of the contacts in an array, with some of their lines read."""
        return RecordLanes(self.builder, kind, [self.address(name, place) for place in self.places], lines)

    def bodies(self, name: str, kind: np.dtype[np.void], lines: Sequence[int]) -> list[RecordLanes]:
        """Return the records of the bodies i and j in an array, with some of their lines read."""
        addresses = [[self.address(name, body) for body in end] for end in self.ends]
        return [RecordLanes(self.builder, kind, end, lines) for end in addresses]

    def fetch_bodies_ahead(self, name: str, lines: Sequence[int]) -> None:
        """Prefetch cache lines of the bodies in a later block."""
        last = self.builder.sub(self.count("pairs"), WORD(WIDTH))
        ahead = self.builder.add(self.places[0], WORD(AHEAD))
        for end in self._ends_from(self.builder.select(self.builder.icmp_signed("<", ahead, last), ahead, last)):
            for body in end:
                for line in lines:
                    fetch_line(self.builder, self.address(name, body), line, to_write=True)

    def materials(self) -> list[Any]:
        """Return the addresses of the contacts' coefficients, see `material_index`."""
        builder, count = self.builder, self.body_count
        many = builder.icmp_signed(">", self.count("places"), WORD(0))
        planes = [builder.add(builder.sub(j, count), WORD(1)) for j in self.ends[1]]
        rows = [builder.select(builder.icmp_signed(">", plane, WORD(0)), plane, WORD(0)) for plane in planes]
        before = builder.block
        with builder.if_then(many):
            known = []
            for ends in zip(*self.ends, strict=True):
                parts = [builder.load(self.address("places", end, WORD(part))) for part, end in enumerate(ends)]
                known.append(builder.add(*parts))
            looked_up = builder.block
        joined = [builder.phi(WORD) for _ in rows]
        for phi, row, other in zip(joined, rows, known, strict=True):
            phi.add_incoming(row, before)
            phi.add_incoming(other, looked_up)
        return [self.address("materials", row) for row in joined]

    def apply(
        self,
        contact: RecordLanes,
        bodies: Sequence[RecordLanes],
        lines: Sequence[int],
        mask: Mask,
        J: Sequence[Lanes],
        torque: Sequence[Lanes] | None,
    ) -> None:
        """Add the effect of an impulse J on j and -J on i to lines of the bodies' records; see `body_state.push`.

        Parameters
        ----------
        mask
            The contacts that exert an impulse; fixed bodies are not written.
        torque
            λ_t × n in N s; its product with a body's lever arm is the angular impulse on that body. None without spin.
        """
        for body, arm, push in zip(bodies, (contact.arm_i, contact.arm_j), ([-a for a in J], J), strict=True):
            by = [along * body.inverse_mass for along in push]
            if torque is not None:
                by += self.turns(body, arm, torque)
            by += [self.nothing] * (WIDTH - len(by))
            body.add(lines, by, mask & (body.inverse_mass > 0.0))

    def one_by_one(
        self, kernel: Callable[..., Any], kinds: Sequence[Any], given: Iterable[Sequence[Any]]
    ) -> list[Lanes]:
        """Call a kernel that returns a vector for each contact, and return the components of the results in lanes.

        ``kinds`` are the types of the arguments, ``given`` their values for each contact.
        """
        vectors = [self.code.call(kernel, ("float64",) * 3, *zip(kinds, values, strict=True)) for values in given]
        return [
            gathered(self.builder, [self.builder.extract_value(vector, axis) for vector in vectors])
            for axis in range(3)
        ]

    def turns(self, body: RecordLanes, arm: Lanes, torque: Sequence[Lanes]) -> list[Lanes]:
        """Return the changes of the angular velocities of bodies by λ_t × n; see `apply`."""
        lever = arm * body.inverse_inertia
        return [(lever * about).where(lever > 0.0, self.nothing) for about in torque]

    def _setting_at(self, name: str, kind: Any) -> Any:
        """Return the address of a setting."""
        assert SETTINGS.fields is not None
        settings = self.builder.bitcast(self.address("settings", WORD(0)), BYTE.as_pointer())
        return self.builder.bitcast(self.builder.gep(settings, [WORD(SETTINGS.fields[name][1])]), kind.as_pointer())

    def _ends_from(self, first: Any) -> list[list[Any]]:
        """Return the indices i and then j of eight contacts."""
        places = [self.builder.add(first, WORD(k)) for k in range(WIDTH)]
        return [[self.builder.load(self.address("pairs", at, WORD(end))) for at in places] for end in range(2)]
