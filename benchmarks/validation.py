"""Measures the numbers of docs/validation.md and prints them; draws its figures into docs/.

PYTHONPATH=tests python benchmarks/validation.py      (needs the extra "plot"; some minutes)
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from monte_carlo_gas import rough_gas
from periodic_gas import carnahan_starling, cooling, enskog_rate, measure_equilibrium, rough_ratio
from poured_packing import contacts_of_a_body, packing_fraction, pour
from published.test_granular_gas import stick_ratio
from published.test_oblique_impact import slip_after
from published.test_two_body_bounce import APOCENTRES, AT_REST, BOUNCES, separations

DOCS = Path(__file__).parent.parent / "docs"
GAS_STEPS = ((0.1, 0.004), (0.2, 0.002), (0.3, 0.001), (0.4, 0.0007))  # packing, s; those of test_hard_sphere_gas.py
COLLISIONS = 60_000
GLASS, ACETATE = (0.97, 0.092), (0.87, 0.25)  # e and μ as measured by Foerster et al. (1994)
TANGENTIAL_RESTITUTION = 0.44  # β₀ of the same spheres


def main() -> None:
    bounce()
    oblique_impact()
    hard_sphere_gas()
    haff()
    rough_spheres()
    packings()


def figure(panels: int = 1) -> tuple[Figure, list[Axes]]:
    made, axes = plt.subplots(1, panels, figsize=(5.2 * panels, 3.6), squeeze=False, layout="constrained")
    for ax in axes[0]:
        ax.spines[["top", "right"]].set_visible(False)
    return made, list(axes[0])


def save(made: Figure, name: str) -> None:
    made.savefig(DOCS / f"validation-{name}.png", dpi=90)
    plt.close(made)


def bounce() -> None:
    dt = 0.004
    time, distance, _ = separations(max_dt=dt, target_dx=1e-6, duration=90.0)
    low = [k for k in range(1, len(time) - 1) if distance[k - 1] > distance[k] <= distance[k + 1]][:4]
    high = [k for k in range(1, len(time) - 1) if distance[k - 1] < distance[k] >= distance[k + 1]][:4]
    rest = time[np.flatnonzero(np.abs(distance - 4.0) > 1e-6)[-1]]
    print(f"bounces at {time[low]}, off by {(time[low] - BOUNCES) / dt} dt")
    print(f"apocentres {distance[high]}, off by {(distance[high] - APOCENTRES) / dt} dt; at rest from {rest}")
    made, (ax,) = figure()
    ax.plot(time, distance, label="carom, steps of at most 0.004 s")
    ax.plot(BOUNCES, [4.0] * 4, "k+", markersize=10, label="contacts, Kepler")
    ax.plot(time[high], APOCENTRES, "k_", markersize=10, label="apocentres, Kepler")
    ax.axvline(AT_REST, color="grey", linewidth=0.8, label="at rest")
    ax.set(xlabel="time / s", ylabel="separation / m", xlim=(60, 90), ylim=(3.8, 8), title="Two spheres, e = 1/2")
    ax.legend(frameon=False)
    save(made, "bounce")


def oblique_impact() -> None:
    made, (ax,) = figure()
    worst = 0.0
    for (restitution, friction), colour, name in ((GLASS, "C0", "glass"), (ACETATE, "C1", "cellulose acetate")):
        switch = 3.5 * friction * (1 + restitution)
        psi = np.linspace(0, 3, 61)
        after = np.array([slip_after(float(each), restitution, friction, friction)[0] for each in psi])
        worst = max(worst, float(np.abs(after - np.maximum(0.0, psi - switch)).max()))
        ax.plot(psi, after, ".", color=colour, label=f"carom, {name}: e = {restitution}, μ = {friction}")
        ax.plot(psi, np.maximum(0.0, psi - switch), color=colour, linewidth=0.8)
        ax.plot(psi, np.maximum(-TANGENTIAL_RESTITUTION * psi, psi - switch), ":", color=colour)
    ax.plot([], [], "k-", linewidth=0.8, label="stick or slide, the rigid limit")
    ax.plot([], [], "k:", label='with β₀ = 0.44 (Foerster 1994): law = "walton"')
    ax.axhline(0.0, color="grey", linewidth=0.5)
    ax.set(
        xlabel="Ψ, slip before / speed of approach", ylabel="Ψ', slip after", title="Oblique impact of equal spheres"
    )
    ax.legend(frameon=False, fontsize=8)
    save(made, "oblique-impact")
    print(f"oblique impact: at most {worst:.1e} from the rigid limit")


def hard_sphere_gas() -> None:
    made, (state, bias) = figure(2)
    packing = np.linspace(0, 0.45, 100)
    state.plot(packing, [carnahan_starling(float(phi)) for phi in packing], label="Carnahan & Starling")
    for number, (phi, dt) in enumerate(GAS_STEPS):
        steps = dt * np.array([4.0, 2.0, 1.0])
        gases = [measure_equilibrium(phi, float(step), COLLISIONS) for step in steps]
        errors = np.array([gas.compressibility / carnahan_starling(phi) - 1 for gas in gases])
        rates = np.array([gas.rate / enskog_rate(phi) - 1 for gas in gases])
        for step, gas, error, rate in zip(steps, gases, errors, rates, strict=True):
            print(f"φ = {phi}, dt = {step:g}: Z = {gas.compressibility:.4f} ({error:+.2%}), rate {rate:+.2%}")
        state.plot(phi, gases[-1].compressibility, "ko", label="carom" if number == 0 else None)
        aside, scatter, colour = steps / dt * (1 + 0.015 * number), 100 / sqrt(COLLISIONS), f"C{number}"
        bias.errorbar(aside, 100 * errors, scatter, fmt="o-", color=colour, label=f"Z, φ = {phi}")
        bias.errorbar(aside, 100 * rates, scatter, fmt="s:", color=colour, markerfacecolor="none")
    bias.plot([], [], "ks:", markerfacecolor="none", label="collision rate")
    bias.axhspan(-1, 1, color="grey", alpha=0.15, linewidth=0)
    state.set(xlabel="packing fraction φ", ylabel="Z = p / (n T)", title="2048 elastic spheres")
    bias.set(xlabel="dt / dt of the test", ylabel="off the reference / %", title="What late impacts cost")
    bias.set_xlim(left=0)
    state.legend(frameon=False)
    bias.legend(frameon=False, fontsize=8)
    save(made, "hard-sphere-gas")


def haff() -> None:
    times, temperatures, tau = cooling(restitution=0.9, packing=0.05, cells=5, cfl=0.03, until=9.0, seed=0)
    late = times > tau
    exponent = np.polyfit(np.log1p(times[late] / tau), np.log(temperatures[late]), 1)[0]
    measured = 1 / np.polyfit(times, temperatures**-0.5, 1)[0]
    print(f"Haff: exponent {exponent:.3f}, τ = {measured:.3f} s for {tau:.3f} s ({measured / tau - 1:+.2%})")
    made, (ax,) = figure()
    ax.loglog(1 + times / tau, temperatures, label="carom, 500 spheres, e = 0.9")
    ax.loglog(1 + times / tau, (1 + times / tau) ** -2, "k--", linewidth=1, label="Haff: (1 + t/τ)⁻²")
    ax.set(xlabel="1 + t/τ", ylabel="T / T₀", title="Cooling of an inelastic gas")
    ax.legend(frameon=False)
    save(made, "haff")


SHOWN = 6  # runs of each kind that are drawn


def rough_spheres() -> None:
    made, (ax,) = figure()
    for restitution, colour in ((1.0, "C0"), (0.9, "C1")):
        closure = stick_ratio(restitution)
        boltzmann = rough_gas(restitution, spheres=40_000, until=75.0, seed=0)
        expected = boltzmann[boltzmann[:, 0] > 25.0, 1].mean()
        means = []
        for seed in range(32):
            rows = rough_ratio(restitution, float(seed % 2), until=75.0, seed=seed)
            means.append(rows[rows[:, 0] > 25.0, 1].mean())
            if seed < SHOWN:
                ax.plot(*rows.T, color=colour, linewidth=0.5, label=f"carom, e = {restitution}" if seed == 0 else None)
        ax.axhline(expected, color="k", linewidth=1, label="Boltzmann" if restitution == 1 else None)
        ax.axhline(closure, color="k", linestyle="--", linewidth=1, label="Maxwellian" if restitution == 1 else None)
        error = float(np.std(means, ddof=1)) / sqrt(len(means))
        print(f"rough spheres, e = {restitution}: {np.mean(means):.4f} ± {error:.4f}, {expected:.4f}, {closure:.4f}")
        print(f"  off Boltzmann by {np.mean(means) / expected - 1:+.2%}, Boltzmann off {expected / closure - 1:+.2%}")
    ax.set(xlabel="collisions of a sphere", ylabel="rotational / translational T", title="Rough spheres that stick")
    ax.set_ylim(0, 1)
    ax.legend(frameon=False, ncols=2)
    save(made, "rough-spheres")


def packings() -> None:
    frictions = (0.0, 0.03, 0.1, 0.3, 1.0, 10.0)
    filled, touching = [], []
    for friction in frictions:
        smooth = friction == 0.0  # slow to settle: nothing holds it except the last contact that it needs
        space = pour(
            2000, 12.0, friction, settling=0.5 if smooth else 0.2, until=110.0, sweeps=30 if smooth else 8, seed=1
        )
        filled.append(packing_fraction(space))
        touching.append(contacts_of_a_body(space, fewest=4 if smooth else 2))
        print(f"packing, μ = {friction}: {filled[-1]:.4f}, {touching[-1]:.2f} contacts")
    made, panels = figure(2)
    shown = [max(friction, 0.01) for friction in frictions]
    for ax, values, published, label in (
        (panels[0], filled, (0.639, 0.55), "packing fraction"),
        (panels[1], touching, (6.0, 4.0), "contacts of a sphere"),
    ):
        ax.semilogx(shown, values, "ko-", label="carom, 2000 spheres poured")
        ax.axhline(published[0], color="C0", linestyle="--", linewidth=1, label="published, without friction")
        ax.axhline(published[1], color="C1", linestyle="--", linewidth=1, label="published, with much friction")
        ax.set(xlabel="friction μ (leftmost: 0)", ylabel=label)
        ax.legend(frameon=False, fontsize=8)
    save(made, "packings")


if __name__ == "__main__":
    main()
