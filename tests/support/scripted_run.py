"""Runs without physics: bodies on circles that touch now and then."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from carom.event import Event
from carom.recording.schema.header import Header
from carom.state.books import Books, Extreme, Extremes, MomentumBaseline, MonitorState, PaceTally
from carom.state.energies import Energy, EnergyBaseline, Ledger, Origin
from carom.state.frame import CollisionGraph, Frame

RUN_ID = "5e0f5d0e-9c0b-4f53-8a4c-1d2d6b1f3a77"


class ScriptedRun:
    """A merry-go-round of bodies: a frame for every step, deterministic, cheap."""

    def __init__(self, bodies: int = 60, *, spins: bool = True, collides: bool = True, seed: int = 1, **header: Any):
        random = np.random.default_rng(seed)
        self.n = bodies
        radius = random.uniform(0.5, 1.5, bodies)
        mass = 2000 * 4 / 3 * np.pi * radius**3
        self.orbit = 3.0 * bodies ** (1 / 3) * np.cbrt(random.uniform(0.05, 1, bodies))
        self.phase = random.uniform(0, 2 * np.pi, bodies)
        self.height = random.uniform(-0.6, 0.6, bodies) * self.orbit
        self.spin = random.normal(0, 1.0, (bodies, 3)) if spins else None
        self.collides = collides
        values: dict[str, Any] = {
            "title": "A merry-go-round",
            "description": "Bodies on circles that pass through each other.",
            "scene_toml": 'title = "A merry-go-round"\n',
            "seed": seed,
            "run_id": RUN_ID,
            "names": [f"body-{k}" for k in range(bodies)],
            "group": (np.arange(bodies) % 3).astype(np.int64),
            "mass": mass,
            "radius": radius,
            "inertia": 0.4 * mass * radius**2,
            "spins": spins,
            "has_orientation": spins,
            "has_torque": spins,
            "has_friction": spins,
            "forces": frozenset({"gravity"}),
            "collides": collides,
            "stabilises": collides,
            "body_colouring": False,
            "duration": 10.0,
            "shortest_dt_hint": 0.01,
            "properties": {
                "version.carom": "0.1.0",
                "version.rerun": "0.41.0",
                "command": "carom run scripted.toml",
                "threads": 2,
            },
        }
        self.header = Header(**(values | header))

    def frames(self, count: int, dt: float = 0.05) -> Iterator[Frame]:
        ledger = Ledger()
        for step in range(count):
            frame = self.frame(step, step * dt, dt if step else 0.0, ledger)
            ledger = Ledger(
                ledger.restitution + 40.0 * len(frame.contacts.pairs),
                ledger.friction + 15.0 * len(frame.contacts.pairs),
                ledger.stabilisation + 2.0 * len(frame.contacts.pairs),
            )
            yield frame

    def frame(self, step: int, time: float, dt: float, ledger: Ledger) -> Frame:
        angle = self.phase + time * 3.0 / self.orbit
        position = np.stack([self.orbit * np.cos(angle), self.orbit * np.sin(angle), self.height], axis=1)
        velocity = 3.0 * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
        contacts = self.contacts(position, step)
        torque = self.torques(contacts, velocity)
        mass = self.header.mass
        kinetic = 0.5 * float(mass @ np.sum(velocity**2, axis=1))
        energy = Energy(
            translational=kinetic * (1 + 0.1 * np.sin(time)),
            rotational=0.0 if self.spin is None else 0.05 * kinetic,
            gravitational=-0.4 * kinetic * (1 + 0.2 * np.cos(time)),
            field=0.0,
            ledger=ledger,
            integration_error=1e-6 * kinetic * np.sin(3 * time),
            scale=2 * kinetic,
        )
        orientation, spin = self.orientation(time), None if self.spin is None else self.spin.copy()
        level = "WARN" if step % 40 == 30 else "INFO"
        events = (Event(step, time, level, f"something at step {step}"),) if step % 10 == 0 else ()
        return Frame(
            step=step,
            time=time,
            dt=dt,
            dt_limit="start" if step == 0 else ("velocity" if step % 50 < 30 else "acceleration"),
            position=position,
            velocity=velocity,
            orientation=orientation,
            angular_velocity=spin,
            torque=torque,
            angular_acceleration=None if torque is None else torque / self.header.inertia[:, None],
            contacts=contacts,
            energy=energy,
            momentum=mass @ velocity,
            angular_momentum=mass @ np.cross(position, velocity),
            sweeps=3 if len(contacts.pairs) else 0,
            phase="colliding" if len(contacts.pairs) else "free",
            events=events,
            acceleration=-position,
            previous_dt=dt,
            memory=None,
            books=self.books(energy),
            momentum_error=1e-15 * step,
        )

    def books(self, energy: Energy) -> Books:
        nothing = (0.0, 0.0, 0.0)
        return Books(
            energy=EnergyBaseline(energy.total, energy.scale, Origin(energy.total, 0.0, 0.0)),
            momentum=MomentumBaseline(nothing, nothing, nothing, 1.0, 1.0),
            watch=MonitorState(energy, 0.5, 3),
            moments=Extremes(impact=Extreme(0.1, 7, 0.35, (1, 2)), total_contacts=5),
            activity=0.1,
            phase="free",
            limits=("a limit",),
            pace=PaceTally(),
        )

    def contacts(self, position: np.ndarray, step: int) -> CollisionGraph:
        first, second = np.triu_indices(self.n, 1)
        reach = position[second] - position[first]
        distance = np.linalg.norm(reach, axis=1)
        overlap = self.header.radius[first] + self.header.radius[second] - distance
        # every fourth second nobody touches
        touching = (overlap > 0) & self.collides & (step % 80 >= 20)
        pairs = np.stack([first, second], axis=1)[touching]
        stages = np.arange(len(pairs)) % 5
        nodes = np.full(self.n, -1)
        nodes[pairs.ravel()] = np.arange(2 * len(pairs)) % 4
        normals = reach[touching] / distance[touching, None]
        coloured = nodes if self.header.body_colouring else None
        return CollisionGraph(pairs, normals, overlap[touching], stages, coloured)

    def torques(self, contacts: CollisionGraph, velocity: np.ndarray) -> np.ndarray | None:
        if self.spin is None:
            return None
        torque = np.zeros((self.n, 3))
        i, j = contacts.pairs.T
        slip = 5e3 * np.cross(contacts.normals, velocity[j] - velocity[i])
        np.add.at(torque, i, slip)
        np.add.at(torque, j, slip)
        return torque

    def orientation(self, time: float) -> np.ndarray | None:
        if self.spin is None:
            return None
        rate = np.linalg.norm(self.spin, axis=1, keepdims=True)
        half = 0.5 * rate * time
        return np.concatenate([self.spin / rate * np.sin(half), np.cos(half)], axis=1)
