"""The contacts of a step, from the search to the last impulse: what `Space` calls, in this order.

1. `hold`: after the first kick, what lasts is kept from closing during the drift
2. `find`: which bodies touch, colours, and overlaps of contacts at rest undone
3. `resolve`: impulses, once forces have acted on the final positions
4. `turn`: the torques and angular accelerations that the impulses amount to
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
from carom.physics.contact.lasting import Hold, hold
from carom.physics.contact.memory import ContactMemory
from carom.physics.contact.rest import largest_square, rest_speeds
from carom.physics.contact.search import PlaneSearch, contact_geometry, search_by
from carom.physics.contact.solver import resolve_contacts, still_closing
from carom.physics.contact.stabilisation import BAUMGARTE, push_apart, work_of_pushes
from carom.physics.error import PhysicsError
from carom.physics.kernel import kernel
from carom.physics.profile import Profile
from carom.scene.halfspace import HalfSpaces
from carom.scene.requirements import Requirements
from carom.scene.schema import Contact

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TOUCHING = 1e-9  # of the sum of radii; what is so near touches: the sweeps and rounding leave lasting contacts there
ROUNDING = 4  # units in the last place of the farthest coordinate, likewise
NEAR = 0.1  # of the smallest radius; what is within reach of a step's fall is watched up to so far


class ContactStage:
    """Finds and resolves the contacts of each step.

    Parameters
    ----------
    contact
        The scene's section.
    bodies, planes
        What may touch.
    requirements
        What is modelled.
    box
        Size of the periodic box, (3,) m; zeros in open space.
    field
        (3,) m/s², the uniform field as far as it pulls all alike: zero if something is fixed.
    """

    def __init__(
        self,
        contact: Contact,
        bodies: Bodies,
        planes: HalfSpaces,
        requirements: Requirements,
        box: FloatArray,
        field: FloatArray,
    ) -> None:
        self._contact = contact
        self._bodies = bodies
        self._planes = planes
        self._box = box
        self._field = field
        self._search = search_by(contact.search, bodies.radius, box)
        fixed = bodies.ends.inverse_mass[: len(bodies)] == 0.0
        self._plane_search = PlaneSearch(bodies.radius, bodies.ends.inverse_mass, planes)
        self._smallest = float(bodies.radius.min())
        self._rounding = 0.0  # m, of the coordinates
        self._has_statics = len(planes) > 0 or bool(fixed.any())
        own = (contact.restitution, contact.static_friction, contact.kinetic_friction)
        self._law = np.vstack((np.array(own), planes.law))
        self._friction = requirements.friction.modelled
        self._lasts = contact.solver == "lasting" and (requirements.gravity.modelled or requirements.field.modelled)
        self.warned: set[str] = set()  # limits reached and told so far
        self._angular_impulse = np.zeros_like(bodies.ends.angular_velocity)
        self._compile()

    def forget(self) -> None:
        """Begin anew, as before the first step."""
        self._begin(empty_graph())
        self._angular_impulse[:] = 0.0
        self._hold = Hold.empty()
        self._dt = 0.0  # s, the step that the contacts were found for
        self.held: FloatArray = np.zeros((0, 3))  # J, the ledger of each contact in the first kick

    @property
    def memory(self) -> ContactMemory | None:
        """What the next step begins with; None where no contact can last."""
        if not self._lasts:
            return None
        return ContactMemory(self._graph.pairs, self._rest_speed, self._dt, self._hold)

    def recall(self, memory: ContactMemory | None) -> None:
        """Go on after the step that left a memory, the bodies being where they were then."""
        self.forget()
        if memory is not None:
            if any(
                len(pairs) and pairs.max() >= len(self._bodies.ends.radius)
                for pairs in (memory.pairs, memory.hold.pairs)
            ):
                raise PhysicsError("the contacts of the checkpoint are of bodies that are not there")
            geometry = self._geometry(memory.pairs)
            self._begin(self._coloured(memory.pairs, geometry))
            self._normals, self._arms, self._gap_overlaps = geometry
            self._rest_speed, self._dt, self._hold = memory.rest_speed, memory.dt, memory.hold

    def begin(self, dt: float) -> None:
        """Find what touches at the start of a run, so that it lasts from the first step on, of about dt."""
        if self._lasts:
            self._order_contacts(self._near(dt), dt)
            self._normals, self._arms, self._gap_overlaps = self._geometry(self._graph.pairs)

    def hold(self, kick: float, dt: float) -> None:
        """Keep the contacts of the step before from closing in the drift of length dt that follows a kick, in s."""
        self.held = np.zeros((len(self._graph), 3))
        if self._is_at_rest():
            closing = np.maximum(0.0, -self._gap_overlaps) / dt
            # at rest is what closes by no more than this kick has caused, and by what half a step's fall adds to that
            fastest = self._rest_speed * ((kick + 0.5 * dt) / self._dt)
            self._find_impulses(kick, dt, closing, fastest, self.held)

    def find(self, dt: float, profile: Profile) -> None:
        """Find the contacts at the present positions, order them, and push those at rest apart."""
        pairs = self._near(dt)
        profile.mark("search")
        if len(pairs) == 0:
            self._begin(empty_graph())
            return
        self._order_contacts(pairs, dt)
        profile.mark("colouring")
        if self._contact.stabilisation == "split":
            self._push()
        profile.mark("stabilisation")

    def resolve(self, dt: float, kick: float) -> None:
        """Apply the impulses of the contacts found, with forces and velocities of the final positions.

        Parameters
        ----------
        dt
            s, the step.
        kick
            s, the part of it that the last kick took.
        """
        if len(self._graph):
            self._resolve(dt, kick)
        else:
            self._hold = Hold.empty()

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
        fresh = [text for text in reached if text not in self.warned]
        self.warned.update(fresh)
        return fresh

    def _begin(self, graph: CollisionGraph) -> None:
        """Take a graph, with nothing done to its contacts yet."""
        m = len(graph)
        self._graph = graph
        self._order = stage_order(graph.colours)
        self._pushes = np.zeros((m, 3))  # m, Σ δ n of each contact
        self._apart = np.zeros(m, dtype=bool)  # whether they were only near when they were found
        self.work: FloatArray = np.zeros((m, 3))  # J, the ledger of each contact, seen or not
        self._approach = np.zeros(m)
        self._rest_speed = np.zeros(m)
        self._show(slice(None))
        self._normals, self._arms, self._gap_overlaps = np.zeros((m, 3)), np.zeros((m, 2)), np.zeros(m)
        self.sweeps = 0
        self._too_few_sweeps = False

    def _near(self, dt: float) -> IntArray:
        """Find the pairs that touch and, where contacts last, those that a step's fall from rest could make touch.

        Sweeps that end early leave gaps. A contact that is lost for it begins from nothing in the next step, and a pile
        never comes to rest: 300 bodies kept 5 × 10⁻⁴ of their energy, instead of 10⁻²².
        """
        position = self._bodies.position
        stretch, slack = 1.0, 0.0
        if self._lasts:
            fall = np.sqrt(largest_square(self._bodies.acceleration, self._field)) * dt * dt
            self._rounding = ROUNDING * float(np.spacing(np.abs(position).max()))
            stretch, slack = 1.0 + TOUCHING, self._rounding + min(fall, NEAR * self._smallest)
        pairs = self._search.pairs(position, stretch, slack)
        return self._plane_search.merged(pairs, position, stretch, slack) if self._has_statics else pairs

    def _order_contacts(self, pairs: IntArray, dt: float) -> None:
        ends, geometry = self._bodies.ends, self._geometry(pairs)
        _, arms, overlaps = geometry
        self._begin(self._coloured(pairs, geometry))
        self._apart = overlaps < -(TOUCHING * (arms.sum(axis=1) + overlaps) + self._rounding)
        self._rest_speed = rest_speeds(pairs, ends.acceleration, ends.inverse_mass, self._field, dt)
        self._dt = dt  # s, the step that they are for

    def _coloured(self, pairs: IntArray, geometry: tuple[FloatArray, FloatArray, FloatArray]) -> CollisionGraph:
        normals, _, overlaps = geometry
        body_colours = None
        if self._contact.colouring == "bodies":
            colours, body_colours = colour_bodies(pairs, len(self._bodies))
        else:
            colours = colour_contacts(pairs, self._bodies.ends.inverse_mass)
        return CollisionGraph(pairs, normals, np.maximum(overlaps, 0.0), colours, body_colours)

    def _resolve(self, dt: float, kick: float) -> None:
        contact, ends, graph = self._contact, self._bodies.ends, self._graph
        self._normals, self._arms, self._gap_overlaps = self._geometry(graph.pairs)
        if contact.stabilisation == "split":
            work_of_pushes(graph.pairs, self._pushes, ends.acceleration, ends.inverse_mass, self.work)
        bias_rate = BAUMGARTE / dt if contact.stabilisation == "baumgarte" else 0.0
        lasting = self._is_at_rest()
        self.sweeps = resolve_contacts(
            self._order,
            graph.pairs,
            self._normals,
            self._arms,
            graph.overlaps,
            ends.velocity,
            ends.acceleration,
            ends.angular_velocity if self._friction else ends.angular_velocity[:0],
            ends.inverse_mass,
            ends.inverse_inertia,
            self._law,
            np.where(self._gap_overlaps < 0.0, np.inf, self._rest_speed) if lasting else self._rest_speed,
            lasting,
            bias_rate,
            contact.sweeps,
            self.work,
            self._approach,
            self._angular_impulse,
        )
        overlap, seen = self._gap_overlaps, ~self._apart
        if lasting and np.any(self._approach <= self._rest_speed):
            closing = np.where(overlap < 0.0, -overlap / dt, -bias_rate * overlap)
            fastest = np.where(overlap < 0.0, self._rest_speed, np.inf)  # what touches fast has been resolved
            held, impulse = self._find_impulses(kick, 0.0, closing, fastest, self.work)
            self.sweeps = max(self.sweeps, held)
            seen |= impulse[:, 0] > 0.0
        else:
            self._hold = Hold.empty()
        self._show(slice(None) if seen.all() else seen)
        if self.sweeps == contact.sweeps:
            self._too_few_sweeps = still_closing(
                graph.pairs, self._normals, ends.velocity, self._approach, self._rest_speed
            )

    def _is_at_rest(self) -> bool:
        """Tell whether something presses the contacts together: without that, all of them are impacts."""
        return self._lasts and len(self._graph) > 0 and float(self._rest_speed.max()) > 0.0

    def _find_impulses(
        self, kick: float, dt: float, closing: FloatArray, fastest: FloatArray, ledger: FloatArray
    ) -> tuple[int, FloatArray]:
        """Hold the contacts after a kick, with a drift of length dt to come or with none, 0; both in s.

        Returns the number of sweeps and the impulses, (m, 4) N s.
        """
        pairs = self._graph.pairs
        impulse = self._hold.carried_to(pairs, self._normals, kick)
        if kick > 0.0:  # Euler's step ends without one: what its first kick needed is what the next begins with
            self._hold = Hold(pairs, impulse, kick)
        sweeps = hold(
            self._order,
            pairs,
            self._normals,
            self._arms,
            closing,
            dt,
            fastest,
            self._bodies.ends,
            self._friction,
            self._law,
            kick if dt > 0.0 else 0.0,
            impulse,
            self._contact.sweeps,
            ledger,
            self._angular_impulse,
        )
        return sweeps, impulse

    def _show(self, which: slice | NDArray[np.bool_]) -> None:
        """Let those contacts be seen that touch or carry an impulse, not those that are merely near."""
        graph = self._graph
        if not isinstance(which, slice):
            graph = CollisionGraph(
                graph.pairs[which],
                graph.normals[which],
                graph.overlaps[which],
                graph.colours[which],
                graph.body_colours,
            )
        self.graph: CollisionGraph = graph
        self.contributions: FloatArray = self.work[which]  # J, the ledger of each of them in this step
        self.approach: FloatArray = self._approach[which]  # m/s, closing speed before the impulses
        self.rest_speed: FloatArray = self._rest_speed[which]  # m/s, up to which a contact is at rest

    def _geometry(self, pairs: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return contact_geometry(pairs, self._bodies.position, self._bodies.radius, self._box, self._planes)

    def _push(self) -> None:
        bodies = self._bodies
        push_apart(
            self._order,
            self._graph.pairs,
            bodies.position,
            bodies.ends.velocity,
            bodies.ends.inverse_mass,
            bodies.radius,
            self._box,
            self._planes.normal,
            self._planes.offset,
            self._law,
            self._rest_speed,
            self._contact.sweeps,
            self.work,
            self._pushes,
        )

    def _compile(self) -> None:
        """Send no contacts through every kernel, so that the first real one does not wait for a compiler."""
        self.forget()
        self._order_contacts(empty_graph().pairs, 1.0)
        self._push()
        self._resolve(1.0, 1.0)
        if self._lasts:
            for dt in (1.0, 0.0):
                self._find_impulses(1.0, dt, np.zeros(0), np.zeros(0), self.work)
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
