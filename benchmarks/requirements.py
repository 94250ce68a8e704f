"""The cost of spin where nothing needs it: a frictionless scene, in carom and in a copy without any code for spin.

    python benchmarks/requirements.py [--rounds 12]

A program makes the copy: from the kernels of the contacts, it removes every test of whether bodies spin, and the code
that runs if they do. Contenders run in processes of their own, in turns, through the same steps of the same scene.
Their states must be equal, bit for bit. Two scenes: elastic spheres in a periodic box, filled to 0.3, all of whose
contacts are impacts; and spheres that fall on a floor between walls and come to rest on each other.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import carom
from measurement import save

STEPS = 50  # a round
BODIES = 12  # along a side of the heap; 16 along a side of the gas

WORKER = """
import json, sys, time
from carom.physics.space import Space
from carom.scene.load import Scene
space = Space(Scene.from_dict(json.loads(sys.stdin.readline())), 1)
moving = (space.state.position, space.state.velocity)
for line in sys.stdin:
    began = time.perf_counter()
    for _ in range(int(line)):
        space.compute_dynamics(space.step + 1)
    spent = time.perf_counter() - began
    bits = "".join(array.tobytes().hex() for array in moving)
    print(json.dumps([spent, hash(bits), len(space.contacts)]), flush=True)
"""


def lattice(side: int, spacing: float, height: float) -> list[dict[str, Any]]:
    """Spheres of radius 1 m about the origin, each a little off its site and in motion."""
    bodies = []
    for k in range(side**3):
        site = [(k // side**axis % side - 0.5 * (side - 1)) * spacing for axis in range(3)]
        off = [0.19 * ((7 * k + 3 * axis) % 11 / 5 - 1) for axis in range(3)]
        velocity = [(5 * k + 2 * axis) % 13 / 6 - 1 for axis in range(3)]
        place = [x + dx for x, dx in zip(site, off, strict=True)]
        bodies.append({"position": [place[0], place[1], place[2] + height], "velocity": velocity, "mass": 1.0})
    return bodies


def scenes() -> dict[str, dict[str, Any]]:
    gas, heap = 16, BODIES
    common = {"time": {"duration": 1e6, "fixed_dt": 0.02}, "record": {"every": 1e6, "check_every": 10**6}}
    smooth = {"static_friction": 0.0}
    return {
        "gas": {
            "body": lattice(gas, 2.4, 0.0),
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "timing": "end-of-step", **smooth},
            "domain": {"boundary": "periodic", "size": [2.4 * gas] * 3},
            **common,
        },
        "heap": {
            "body": lattice(heap, 2.4, 0.0),
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "contact": {"restitution": 0.2, **smooth},
            "domain": {"boundary": "walls", "size": [2.4 * heap + 1.0] * 3},
            **common,
        },
    }


class _NoSpin(ast.NodeTransformer):
    """Deletes the code that kernels run if bodies spin, and the test of whether they do."""

    def visit_Assign(self, node: ast.Assign) -> ast.AST | None:
        if isinstance(node.targets[0], ast.Name) and node.targets[0].id == "spins":
            return None
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
            pairs = list(zip(node.targets[0].elts, node.value.elts, strict=True))
            kept = [(name, value) for name, value in pairs if ast.unparse(name) != "spins"]
            node.targets[0].elts, node.value.elts = [list(column) for column in zip(*kept, strict=True)]
        return self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        asks = ast.unparse(node.test)
        if asks in ("spins", "spins and body.inverse_inertia > 0.0", "len(omega) > 0"):
            return node.orelse
        return self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return node.orelse if ast.unparse(node.test) == "len(omega) > 0" else self.generic_visit(node)

    def visit_For(self, node: ast.For) -> ast.AST:
        self.generic_visit(node)
        for index, statement in enumerate(node.body):
            if isinstance(statement, ast.If) and ast.unparse(statement.test) == "not spins":
                del node.body[index:]
                break
        return node


def without_spin(folder: Path) -> Path:
    """Copy the package into a folder and delete spin from its kernels; return the folder."""
    package = Path(carom.__file__).parent
    shutil.copytree(package, folder / "carom", ignore=shutil.ignore_patterns("__pycache__"))
    solver = folder / "carom" / "physics" / "contact" / "solver"
    for name in ("impacts", "prepare", "solve", "line_search", "energy_audit", "body_state"):
        path = solver / f"{name}.py"
        tree = _NoSpin().visit(ast.parse(path.read_text(encoding="utf-8")))
        left = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
        assert not left & {"spins", "omega"}, f"{name} still knows of spin"
        path.write_text(ast.unparse(ast.fix_missing_locations(tree)) + "\n", encoding="utf-8")
    return folder


class Contender:
    """A process that steps a scene on request."""

    def __init__(self, scene: dict[str, Any], source: Path | None = None) -> None:
        paths = [] if source is None else [str(source)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths + sys.path), "PYTHONHASHSEED": "0"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self._say(json.dumps(scene))

    def step(self, count: int) -> tuple[float, int, int]:
        """Take ``count`` steps; return the seconds, a hash of positions and velocities, and the number of contacts."""
        self._say(str(count))
        assert self._process.stdout is not None
        seconds, bits, contacts = json.loads(self._process.stdout.readline())
        return seconds, bits, contacts

    def close(self) -> None:
        """Let it end."""
        self._process.communicate()

    def _say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()


def compare(scene: dict[str, Any], by_hand: Path, rounds: int) -> dict[str, Any]:
    """Take the contenders through the same steps in turns; return the median ms a step of each."""
    contenders = {
        "as required": Contender(scene),
        "as required, once more": Contender(scene),  # what the others' ratios are worth
        "spin deleted by hand": Contender(scene, by_hand),
        "spin and orientation forced on": Contender({**scene, "model": {"force": ["orientation"]}}),
        "friction forced on": Contender({**scene, "model": {"force": ["friction"]}}),
    }
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    contacts = 0
    for number in range(rounds + 1):
        states = set()
        order = list(contenders.items())
        for name, contender in order[number % len(order) :] + order[: number % len(order)]:
            seconds, bits, contacts = contender.step(STEPS)
            states.add(bits)
            if number > 0:  # the first one loads kernels
                spent[name].append(seconds)
        assert len(states) == 1, "the contenders' states differ"
    for contender in contenders.values():
        contender.close()
    base = spent["as required"]
    return {
        "bodies": len(scene["body"]),
        "contacts": contacts,
        "steps": rounds * STEPS,
        "ms": {name: 1e3 * statistics.median(times) / STEPS for name, times in spent.items()},
        "ratio": {
            name: statistics.median(mine / theirs for mine, theirs in zip(times, base, strict=True))
            for name, times in spent.items()
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=12)
    arguments = parser.parse_args()
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        by_hand = without_spin(Path(folder))
        for name, scene in scenes().items():
            results[name] = compare(scene, by_hand, arguments.rounds)
            print(name, json.dumps(results[name], indent=1))
    print(save("requirements", results))


if __name__ == "__main__":
    main()
