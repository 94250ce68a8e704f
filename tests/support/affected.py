"""The tests of what changed: ``python tests/support/affected.py [COMMIT]`` prints them, one a line, for `make check`.

What changed are the files that differ from a commit (by default, the one at which this branch left origin/main), and
new ones. `TESTS` has the tests of each folder and of some files: the row with the longest path counts. To them come the
mirror of a changed module, `tests/a/b/test_c.py` for `src/carom/a/b/c.py`, and changed tests. `make test` runs
everything. ``benchmarks/planted_faults.py`` plants faults in all packages and shows which of them a row misses.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = "tests/test_names_in_docs.py"
_GOLDEN = "tests/golden/test_golden.py::test_the_bits_of_a_scene_are_the_stored_ones_by_every_method"
HEAP, ORBITS = f"{_GOLDEN}[golden/heap]", f"{_GOLDEN}[golden/orbits]"

# What a change may break, by the path from the root without its ending; paths of tests are relative to tests/.
TESTS: dict[str, tuple[str, ...]] = {
    "src/carom/": ("test_public_api.py", "test_registry.py"),
    "src/carom/cli/": ("cli/test_commands.py", "cli/test_help.py", "cli/test_contacts.py"),
    "src/carom/terminal/options": ("cli/test_units.py", "cli/test_moments.py", "lab/hunt/test_hunt.py"),
    "src/carom/cli/run": ("cli/test_replay.py", "cli/test_warmup.py", "cli/test_outputs.py"),
    "src/carom/engines/": ("engines", "cli/test_crosscheck.py"),
    "src/carom/lab/": ("cli/test_help.py",),
    "src/carom/lab/diff/": ("lab/diff", "cli/test_diff.py"),
    "src/carom/lab/fields/": ("lab/fields", "published/test_silo_pressure.py"),
    "src/carom/lab/fork/": ("lab/fork", "cli/test_fork.py"),
    "src/carom/lab/hunt/": ("lab/hunt", "physics/test_random_scenes.py"),
    "src/carom/lab/shrink/": ("lab/shrink",),
    "src/carom/lab/statistics/": ("lab/statistics", "lab/fields", "published/test_gas_statistics.py"),
    "src/carom/lab/sweep/": ("lab/sweep", "cli/test_sweep.py"),
    "src/carom/lab/tradeoff/": ("lab/tradeoff", "cli/test_tune.py"),
    "src/carom/lab/why/": ("lab/why", "cli/test_why.py"),
    "src/carom/laws/": ("laws", "published/test_contact_laws.py", "published/test_rolling.py"),
    "src/carom/state/": ("physics/test_checkpoint.py", "recording/write/test_checkpoint.py", "runs/test_run.py"),
    "src/carom/physics/": ("physics/test_space.py", "physics/test_checkpoint.py"),
    "src/carom/physics/contact/": (
        *(
            "physics/contact/test_impulse.py",
            "physics/contact/test_lasting.py",
            "physics/contact/test_time_of_impact.py",
        ),
        *(
            "physics/contact/test_planes.py",
            "physics/contact/test_contact_tap.py",
            "physics/diagnostics/test_energy.py",
        ),
        *("published/test_oblique_impact.py", "published/test_rolling.py", HEAP),
    ),
    "src/carom/physics/contact/broad_phase/": (
        "physics/contact/test_planes.py",
        "physics/test_mixed_domains.py",
        HEAP,
    ),
    "src/carom/physics/contact/near_pairs": (
        "physics/contact/test_graph.py",
        "physics/contact/test_planes.py",
        "physics/test_mixed_domains.py",
        HEAP,
    ),
    "src/carom/physics/contact/hooks": ("physics/contact", "walls", "physics/forces/test_drag.py"),
    "src/carom/physics/contact/plane_guard": ("physics/contact/test_plane_guard.py", "physics/test_mixed_domains.py"),
    "src/carom/physics/contact/wall_motion": ("walls", "published/test_bouncing_plate.py"),
    "src/carom/physics/contact/moving_walls": ("walls", "published/test_bouncing_plate.py"),
    "src/carom/physics/contact/translating_walls": ("walls", "published/test_bouncing_plate.py"),
    "src/carom/physics/contact/piston_motion": ("walls/test_piston.py",),
    "src/carom/physics/contact/guided_walls": ("walls/test_piston.py",),
    "src/carom/physics/contact/rolling": ("laws", "published/test_rolling.py"),
    "src/carom/physics/contact/sleep/": ("physics/contact/test_sleep.py",),
    "src/carom/physics/contact/solids": ("walls",),
    "src/carom/physics/diagnostics/": (
        "physics/diagnostics",
        "physics/test_space.py",
        "physics/contact/test_impulse.py",
    ),
    "src/carom/physics/forces/": (
        "physics/forces",
        "physics/test_driving_field.py",
        "published/test_orbits.py",
        ORBITS,
    ),
    "src/carom/physics/integrators/": ("physics/integrators", "published/test_orbits.py", ORBITS),
    "src/carom/physics/jit/": ("physics/jit", ORBITS, HEAP),
    "src/carom/physics/look_ahead/": ("physics/look_ahead",),
    "src/carom/physics/placement/": ("physics/placement", "walls/test_wall_clearance.py"),
    "src/carom/physics/shear_motion": ("physics/test_sheared_box.py", "physics/test_sheared_packing.py"),
    "src/carom/physics/sheared_box": ("physics/test_sheared_box.py", "physics/test_sheared_packing.py"),
    "src/carom/physics/step_rule": ("physics/test_time_step.py", "published/test_orbits.py"),
    "src/carom/plan/step_parts": ("physics/contact/test_hooks.py", "test_removable.py"),
    "src/carom/plan/": ("plan", "physics/test_required.py", "runs/test_estimate.py"),
    "src/carom/recording/": ("recording/read/test_recording.py", "recording/write/test_recorder.py"),
    "src/carom/recording/edit/": ("recording/edit", "cli/test_clip.py", "cli/test_repair.py"),
    "src/carom/recording/export/": ("cli/test_export.py",),
    "src/carom/recording/layout/": ("recording/layout", "display/test_panels.py"),
    "src/carom/recording/read/": ("recording/read", "lab/statistics", "cli/test_contacts.py"),
    "src/carom/recording/rrd/": ("recording/rrd", "recording/edit/test_repair.py"),
    "src/carom/recording/schema/": (
        "recording/schema",
        "recording/test_colouring.py",
        "recording/write/test_recorder.py",
    ),
    "src/carom/recording/write/": ("recording/write", "recording/read/test_contacts.py"),
    "src/carom/registry": ("test_registry.py", "test_extension.py", "test_removable.py"),
    "src/carom/runs/": ("runs/test_run.py", "runs/test_replay.py"),
    "src/carom/sharing/": ("sharing", "cli/test_names.py"),
    "src/carom/scene/": (
        "scene/test_load.py",
        "scene/test_explanation.py",
        "physics/placement",
        "physics/contact/test_planes.py",
    ),
    "src/carom/scene/data/": ("scene/data", "cli/test_export.py"),
    "src/carom/scene/matter": ("scene/test_matter.py", "physics/placement", "physics/contact/test_materials.py"),
    "src/carom/scene/schema/": ("scene", "plan", "walls/test_piston.py", "walls/test_translating_walls.py"),
    "src/carom/scene/schema/shear": ("physics/test_sheared_box.py", "physics/test_sheared_packing.py"),
    "src/carom/scene/units/": ("scene/units", "cli/test_units.py"),
    "src/carom/display/": ("display/test_presentation.py", "display/test_panels.py", "display/test_colours.py"),
    "src/carom/display/web/": ("display/test_web.py", "cli/test_view_web.py", "sharing/test_publish.py"),
    "src/carom/terminal/": ("terminal", "cli/test_commands.py", "cli/test_help.py"),
    "src/carom/walls/": ("walls",),
    "benchmarks/": ("test_benchmark_results.py", "test_planted_faults.py"),
    "configs/": ("scene/test_starters.py", "cli/test_stress.py"),
    "examples/": ("test_extension.py",),
    "tests/support/": ("test_affected.py", "test_needs.py", "test_planted_faults.py"),
}


def affected(changed: list[str]) -> list[str]:
    """Return the tests of changed files; both are paths from the root."""
    chosen = set[str]()
    for name in changed:
        stem = name.removesuffix(".py").removesuffix("/__init__")
        if name.startswith("tests/") and is_test(name):
            chosen.add(name)
            continue
        row = max((path for path in TESTS if stem.startswith(path) or f"{stem}/" == path), key=len, default=None)
        chosen.update(f"tests/{test}".replace("tests/tests/", "tests/") for test in (TESTS[row] if row else ()))
        if name.startswith("src/carom/"):
            folder, _, module = stem.removeprefix("src/carom/").rpartition("/")
            mirror = Path("tests") / folder / f"test_{module}.py"
            chosen.update({mirror.as_posix()} if (ROOT / mirror).is_file() else ())
    there = sorted(test for test in chosen if (ROOT / test.partition("::")[0]).exists())
    return [*(test for test in there if not _is_within(test, there)), DOCS] if changed else []


def _is_within(test: str, chosen: list[str]) -> bool:
    """Return whether a chosen folder contains a test, or a chosen file one of its cases."""
    return any(test != other and test.startswith((f"{other}/", f"{other}::")) for other in chosen)


def is_test(name: str) -> bool:
    """Tell whether a file has tests."""
    return name.rpartition("/")[2].startswith("test_")


def _git(*arguments: str) -> list[str]:
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def main() -> None:
    """Print the tests of what changed."""
    since = sys.argv[1] if len(sys.argv) > 1 else _git("merge-base", "origin/main", "HEAD")[0]
    changed = {*_git("diff", "--name-only", since), *_git("ls-files", "--others", "--exclude-standard")}
    relevant = sorted(name for name in changed if name.endswith((".py", ".toml", ".txt")))
    print("\n".join(affected(relevant)))  # noqa: T201


if __name__ == "__main__":
    main()
