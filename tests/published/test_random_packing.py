"""Random packings of equal spheres, poured through a liquid into a box: dense without friction, loose with much of it.

Without friction: Scott & Kilgour, J. Phys. D 2, 863 (1969) measured 0.637 of steel balls; O'Hern et al., Phys. Rev. E
68, 011306 (2003): 0.639 and 6 contacts a sphere, as many as hold it.
With friction: Onoda & Liniger, Phys. Rev. Lett. 64, 2727 (1990) measured 0.555 of glass spheres that settle in a liquid
nearly as dense; Silbert, Soft Matter 6, 2918 (2010): 0.55 and 4 contacts where friction is high, and more of both
the faster the packing comes about; Song, Wang & Makse, Nature 453, 629 (2008): 0.536 and 4 at the least.
"""

from __future__ import annotations

import pytest

from poured_packing import contacts_of_a_body, packing_fraction, pour


@pytest.mark.nightly
@pytest.mark.slow
def test_spheres_without_friction_fill_0_64_and_touch_six_others() -> None:
    # The midst holds 400 spheres: with margins of 2 to 3.5 diameters, 0.632 to 0.640. 3 n contacts in all, with the
    # walls, hold n spheres and no more; a few in a hundred touch and carry nothing.
    space = pour(2000, width=12, friction=0.0, settling=0.5, until=200.0, sweeps=30, seed=1)
    assert packing_fraction(space) == pytest.approx(0.639, abs=0.015)
    assert contacts_of_a_body(space, fewest=4) == pytest.approx(6.0, abs=0.3)
    # rattlers, which nothing presses, need no contacts: they are 2 to 5 in 100 spheres (O'Hern et al. 2003)
    assert len(space.contacts) / len(space.state) == pytest.approx(3.0, rel=0.05)


@pytest.mark.slow
def test_spheres_with_much_friction_fill_0_55_and_touch_between_four_and_five_others() -> None:
    # 0.02: from 0.536 to 0.555 are published. Four contacts hold a sphere with friction; gravity presses a few more.
    space = pour(2000, width=12, friction=10.0, settling=0.2, until=110.0, sweeps=8, seed=1)
    assert packing_fraction(space) == pytest.approx(0.55, abs=0.02)
    assert 4.0 <= contacts_of_a_body(space, fewest=2) <= 5.0
