"""The contacts of a step, from the search to the last impulse: what `Space` calls, in this order.

1. `find`: which bodies touch, colours, and overlaps of contacts at rest undone
2. `resolve`: impulses, once forces have acted on the final positions
3. `turn`: the torques and angular accelerations that the impulses amount to
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.graph import (
    OVERFLOW,
    CollisionGraph,
    colour_bodies,
    colour_contacts,
    empty_graph,
    stage_order,
)
from carom.physics.contact.rest import rest_speeds
from carom.physics.contact.search import contact_geometry, search_by
from carom.physics.contact.solver import resolve_contacts, still_closing
from carom.physics.contact.stabilisation import BAUMGARTE, push_apart, work_of_pushes
from carom.physics.kernel import kernel
from carom.physics.profile import Profile
from carom.scene.requirements import Requirements
from carom.scene.schema import Contact

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class ContactStage:
    """Finds and resolves the contacts of each step."""

    def __init__(
        self, contact: Contact, bodies: Bodies, requirements: Requirements, box: FloatArray, field: FloatArray
    ) -> None:
        self._contact = contact
        self._bodies = bodies
        self._box = box
        self._field = field
        self._search = search_by(contact.search, bodies.radius, box)
        self._friction = requirements.friction.modelled
        self._warned: set[str] = set()
        self._angular_impulse = np.zeros_like(bodies.torque)
        self._compile()

    def forget(self) -> None:
        """Begin anew, as before the first step."""
        self._begin(empty_graph())
        self._angular_impulse[:] = 0.0

    def find(self, dt: float, profile: Profile) -> CollisionGraph:
        """Find the contacts at the present positions, order them, and push those at rest apart."""
        pairs = self._search.pairs(self._bodies.position)
        profile.mark("search")
        if len(pairs) == 0:
            self._begin(empty_graph())
        else:
            self._order_and_push(pairs, dt, profile)
        return self._graph

    def resolve(self, dt: float) -> None:
        """Apply the impulses of the contacts found, with forces and velocities of the final positions."""
        if len(self._graph):
            self._resolve(dt)

    def _begin(self, graph: CollisionGraph) -> None:
        """Take a graph, with nothing done to its contacts yet."""
        m = len(graph)
        self._graph = graph
        self._order = stage_order(graph.colours)
        self._pushes = np.zeros((m, 3))  # m, Σ δ n of each contact
        self.contributions: FloatArray = np.zeros((m, 3))  # J, the ledger of each contact in this step
        self.approach: FloatArray = np.zeros(m)  # m/s, closing speed before the impulses
        self.rest_speed: FloatArray = np.zeros(m)  # m/s, up to which a contact is at rest
        self.sweeps = 0
        self._too_few_sweeps = False

    def _order_and_push(self, pairs: IntArray, dt: float, profile: Profile) -> None:
        bodies = self._bodies
        normals, _, overlaps = contact_geometry(pairs, bodies.position, bodies.radius, self._box)
        body_colours = None
        if self._contact.colouring == "bodies":
            colours, body_colours = colour_bodies(pairs, len(bodies))
        else:
            colours = colour_contacts(pairs, len(bodies))
        self._begin(CollisionGraph(pairs, normals, overlaps, colours, body_colours))
        profile.mark("colouring")
        self.rest_speed = rest_speeds(pairs, bodies.acceleration, self._field, dt)
        if self._contact.stabilisation == "split":
            self._push()
        profile.mark("stabilisation")

    def _resolve(self, dt: float) -> None:
        bodies, contact = self._bodies, self._contact
        graph = self._graph
        normals, distances, overlaps = contact_geometry(graph.pairs, bodies.position, bodies.radius, self._box)
        if contact.stabilisation == "split":
            work_of_pushes(graph.pairs, self._pushes, bodies.acceleration, bodies.mass, self.contributions)
        spinning = bodies.angular_velocity if self._friction else bodies.angular_velocity[:0]
        self.sweeps = resolve_contacts(
            self._order,
            graph.pairs,
            normals,
            distances,
            overlaps,
            bodies.velocity,
            spinning,
            bodies.mass,
            bodies.radius,
            bodies.inertia,
            contact.restitution,
            contact.static_friction,
            contact.kinetic_friction,
            self.rest_speed,
            BAUMGARTE / dt if contact.stabilisation == "baumgarte" else 0.0,
            contact.sweeps,
            self.contributions,
            self.approach,
            self._angular_impulse,
        )
        if self.sweeps == contact.sweeps:
            self._too_few_sweeps = still_closing(graph.pairs, normals, bodies.velocity, self.approach, self.rest_speed)

    def turn(self, dt: float) -> None:
        """Write torques, Σ r × J / dt, and angular accelerations, τ / I, of this step."""
        if self._friction:
            bodies = self._bodies
            _turn(self._angular_impulse, bodies.inertia, dt, bodies.torque, bodies.angular_acceleration)

    def limits_reached(self) -> list[str]:
        """Say, the first time each, which limit of the method this step met."""
        reached = []
        if self._contact.colouring == "contacts" and self._graph.colours.max() == OVERFLOW:
            reached.append(f"More than {OVERFLOW} colours are needed: the rest is resolved in a last, serial stage.")
        if self._too_few_sweeps:
            reached.append(
                f"Contacts were still closing after contact.sweeps = {self._contact.sweeps} passes; "
                "what is left is resolved in later steps."
            )
        fresh = [text for text in reached if text not in self._warned]
        self._warned.update(fresh)
        return fresh

    def _push(self) -> None:
        bodies, contact, graph = self._bodies, self._contact, self._graph
        push_apart(
            self._order,
            graph.pairs,
            bodies.position,
            bodies.velocity,
            bodies.mass,
            bodies.radius,
            self._box,
            contact.restitution,
            self.rest_speed,
            contact.sweeps,
            self.contributions,
            self._pushes,
        )

    def _compile(self) -> None:
        """Send no contacts through every kernel, so that the first real one does not wait for a compiler."""
        self._order_and_push(empty_graph().pairs, 1.0, Profile())
        self._resolve(1.0)
        self.turn(1.0)
        self.forget()


@kernel
def _turn(
    angular_impulse: FloatArray,
    inertia: FloatArray,
    dt: float,
    torque: FloatArray,
    angular_acceleration: FloatArray,
) -> None:
    for i in range(len(inertia)):
        for k in range(3):
            torque[i, k] = angular_impulse[i, k] / dt
            angular_acceleration[i, k] = torque[i, k] / inertia[i]
            angular_impulse[i, k] = 0.0
