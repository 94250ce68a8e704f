"""Sums over all impacts, compared with what they change: spins, the ledger and the number of impacts."""

from __future__ import annotations

import numpy as np
import pytest

from carom.contact_table import ImpactSums
from carom.physics.space import Space
from small_scenes import scene_of


def rough_balls(timing: str) -> Space:
    """Three rough balls that meet obliquely between walls."""
    balls = [
        {"radius": 0.4, "mass": 1.0 + k, "position": [x, y, 0.0], "velocity": [vx, 0.3, 0.1 * k]}
        for k, (x, y, vx) in enumerate([(-1.0, 0.0, 2.0), (0.3, 0.3, -1.0), (1.0, -0.6, 0.5)])
    ]
    return Space(
        scene_of(
            balls,
            time={"duration": 3.0, "fixed_dt": 0.02},
            gravity={"constant": 0.0},
            contact={"restitution": 0.8, "static_friction": 0.4, "timing": timing},
            domain={"boundary": "walls", "size": [4.0, 4.0, 4.0]},
        ),
        record_contacts=True,
    )


@pytest.mark.parametrize("timing", ["time-of-impact", "end-of-step"])
def test_the_sums_account_for_spins_energy_and_impacts(timing: str) -> None:
    space = rough_balls(timing)
    before, *frames = space.run()
    inertia, found = space.state.inertia[:, None], list[ImpactSums]()
    for after in frames:
        assert after.impact_sums is not None
        sums = ImpactSums.of(after.impact_sums)
        assert before.angular_velocity is not None and after.angular_velocity is not None
        # ℓ × J is the torque of both bodies, or of the one that meets a wall, about their centres
        virial, turned = sums.virial, (inertia * (after.angular_velocity - before.angular_velocity)).sum(axis=0)
        moment = [virial[a, b] - virial[b, a] for a, b in ((1, 2), (2, 0), (0, 1))]
        if timing == "time-of-impact":  # at the end of a step, bodies overlap, and their torques have shorter arms
            assert turned == pytest.approx(-np.array(moment), abs=1e-14)
        ledgers = [frame.energy.ledger for frame in (before, after)]
        lost = [ledger.restitution + ledger.friction for ledger in ledgers]
        assert (sums.pairs.restitution_loss + sums.pairs.friction_loss).sum() == pytest.approx(
            lost[1] - lost[0], abs=1e-13
        )
        assert sums.impacts == after.books.moments.impacts - before.books.moments.impacts
        found.append(sums)
        before = after
    whole = ImpactSums.over(found)
    assert whole.impacts >= 4 and whole.pairs.impacts.sum() == whole.impacts
    assert whole.largest_speed == max(sums.largest_speed for sums in found)


def test_sums_written_in_one_row_are_read_back_and_those_of_no_frame_are_zero() -> None:
    *_, last = rough_balls("time-of-impact").run(schedule=lambda *_: False)
    row = last.impact_sums
    assert row is not None
    sums = ImpactSums.of(row)
    assert len(sums.pairs.first) > 1
    assert sums.flat().tolist() == row.tolist() == ImpactSums.over([sums]).flat().tolist()
    nothing = ImpactSums.over(())
    assert not nothing.flat().any() and nothing.impacts == 0.0
    with pytest.raises(ValueError, match="reshape"):
        ImpactSums.of(row[:-1])
