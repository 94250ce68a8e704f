"""An integrator of fourth order: the position extended Forest-Ruth scheme (Omelyan, Mryglod & Folk 2002)."""

from carom.extend import Integrator, Substep

_XI, _LAMBDA, _CHI = 0.1786178958448091, -0.2123418310626054, -0.06626458266981849

PEFRL = Integrator(
    "pefrl",
    "Omelyan's",
    4,
    (
        Substep(0.0, _XI, 0.5 - _LAMBDA),
        Substep(0.0, _CHI, _LAMBDA),
        Substep(0.0, 1.0 - 2.0 * (_CHI + _XI), _LAMBDA),
        Substep(0.0, _CHI, 0.5 - _LAMBDA),
        Substep(0.0, _XI, 0.0),
    ),
)
