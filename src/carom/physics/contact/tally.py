"""What the contacts of a step amount to: how many, the hardest, the deepest, and what they did to the energy.

Counted in every step, from where the contacts are worked on, block by block; the graph that people see of them is put
together only when somebody looks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Ends
from carom.physics.contact.load import APART, APPROACH, BLOCK, COLD, FOUND, HOT, IMPULSE, LEDGER, REST
from carom.physics.contact.sighting import Sighting
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.thread_team import SOLO, Team

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SOME = 1  # block that is worth a part of their own
# what is counted of a block: its ledger; contacts, impacts, Σ ½ μ v_n² of these; the hardest's and its ends, the
# deepest's depth and its ends
COUNTS, CONTACTS, IMPACTS, STRUCK, HARDEST, DEEPEST = 12, 3, 4, 5, 6, 9


class Tally(NamedTuple):
    """The contacts of a step that are seen, those that touch or carry an impulse, and the work of all."""

    work: FloatArray  # (k, 3) J, the ledger, summed over blocks of contacts
    contacts: int
    impacts: int  # on the way each; of those found at the end the contacts that closed faster than one at rest
    struck: float  # J, Σ ½ μ v_n² of these
    hardest: float  # J, the largest ½ μ v_n²
    hardest_pair: tuple[int, int]  # of those that are equally hard the first
    deepest: float  # overlap / smaller radius
    deepest_pair: tuple[int, int]

    @classmethod
    def of(cls, pairs: IntArray, hot: FloatArray, cold: FloatArray, ends: Ends, team: Team) -> Tally:
        """Count contacts; for the arrays see `Load`."""
        blocks = np.empty((-(-len(pairs) // BLOCK), COUNTS))
        team.divide(len(blocks), SOME, _count, pairs, hot, cold, ends.inverse_mass, ends.radius, blocks)
        total = np.empty((1, COUNTS))
        _add_up(blocks, total)
        contacts, impacts, struck = total[0, CONTACTS:HARDEST].tolist()
        if contacts == 0:
            return NONE._replace(work=blocks[:, :CONTACTS])
        hardest, *hard_pair = total[0, HARDEST:DEEPEST].tolist()
        deepest, *deep_pair = total[0, DEEPEST:].tolist()
        return cls(
            work=blocks[:, :CONTACTS],
            contacts=int(contacts),
            impacts=int(impacts),
            struck=struck,
            hardest=hardest,
            hardest_pair=(int(hard_pair[0]), int(hard_pair[1])),
            deepest=deepest,
            deepest_pair=(int(deep_pair[0]), int(deep_pair[1])),
        )

    def with_impacts(self, sighting: Sighting, ledger: FloatArray, ends: Ends) -> Tally:
        """Return the tally of a step that had impacts on the way.

        Parameters
        ----------
        sighting
            All that was seen, the impacts among it.
        ledger
            (k, 3) J, of the impacts.
        """
        graph = sighting.graph
        hot, cold = np.zeros((len(graph), HOT)), np.zeros((len(graph), COLD))
        cold[:, FOUND], cold[:, APPROACH], cold[:, REST] = graph.overlaps, sighting.approach, sighting.rest_speed
        seen = Tally.of(graph.pairs, hot, cold, ends, SOLO)
        return seen._replace(work=np.concatenate((ledger, self.work)), impacts=sighting.impacts)


NONE = Tally(np.zeros((0, 3)), 0, 0, 0.0, 0.0, (0, 0), 0.0, (0, 0))


@long_kernel
def _count(
    lo: int,
    hi: int,
    pairs: IntArray,
    hot: FloatArray,
    cold: FloatArray,
    inverse_mass: FloatArray,
    radius: FloatArray,
    blocks: FloatArray,
) -> None:
    """Count the contacts of the blocks [lo, hi)."""
    for block in range(lo, hi):
        _begin(blocks, block)
        contacts, impacts, struck, hardest, deepest = 0, 0, 0.0, 0.0, 0.0
        for c in range(block * BLOCK, min(len(pairs), (block + 1) * BLOCK)):
            for k in range(3):
                blocks[block, k] += cold[c, LEDGER + k]
            if cold[c, APART] > 0.0 and hot[c, IMPULSE] <= 0.0:
                continue
            i, j, approach = pairs[c, 0], pairs[c, 1], cold[c, APPROACH]
            contacts += 1
            energy = 0.5 * approach * approach / (inverse_mass[i] + inverse_mass[j])
            if approach > cold[c, REST]:
                impacts += 1
                struck += energy
            if energy >= hardest:
                hardest = energy
                _keep_larger(blocks, block, HARDEST, energy, i, j)
            depth = cold[c, FOUND] / min(radius[i], radius[j])
            if depth >= deepest:
                deepest = depth
                _keep_larger(blocks, block, DEEPEST, depth, i, j)
        blocks[block, CONTACTS], blocks[block, IMPACTS], blocks[block, STRUCK] = contacts, impacts, struck


@kernel
def _begin(counts: FloatArray, row: int) -> None:
    for k in range(COUNTS):
        counts[row, k] = 0.0
    for k in (HARDEST, DEEPEST):
        counts[row, k + 1] = counts[row, k + 2] = np.inf


@kernel
def _add_up(blocks: FloatArray, total: FloatArray) -> None:
    _begin(total, 0)
    for block in range(len(blocks)):
        for k in range(HARDEST):
            total[0, k] += blocks[block, k]
        for k in (HARDEST, DEEPEST):
            _keep_larger(total, 0, k, blocks[block, k], blocks[block, k + 1], blocks[block, k + 2])


@kernel
def _keep_larger(counts: FloatArray, row: int, k: int, value: float, i: float, j: float) -> None:
    """Keep the largest value and its pair; of equal values the first pair."""
    comes_first = i < counts[row, k + 1] or (i == counts[row, k + 1] and j < counts[row, k + 2])
    if value > counts[row, k] or (value == counts[row, k] and comes_first):
        counts[row, k], counts[row, k + 1], counts[row, k + 2] = value, i, j
