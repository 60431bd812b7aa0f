"""What a step may be asked: settings of contacts, options, and what of them is refused."""

import math
from typing import NamedTuple

from rbs.broadphase import BROAD_PHASES
from rbs.schedules import CONSTRAINT_SCHEDULINGS
from rbs.softstep import CONTACT_SOLVERS
from rbs.vectors import number


class ContactSettings(NamedTuple):
    """How contacts are resolved; see `resolve_collision`."""

    CRCoeff: float
    closingOnly: bool
    mu: float


def contact_settings(CRCoeff, closingOnly, mu):
    """The ContactSettings of a caller's arguments; raises ValueError."""
    settings = ContactSettings(number(CRCoeff), bool(closingOnly), number(mu))
    if not math.isfinite(settings.CRCoeff):
        raise ValueError(f"the restitution must be finite, not {settings.CRCoeff:g}")
    if not 0.0 <= settings.mu < math.inf:
        raise ValueError(f"the friction must be finite and not negative, not {settings.mu:g}")
    return settings


def check_step_options(
    timeStep, tolerance, constraintScheduling, broadPhase, contactSolver, substeps, closingOnly
):
    """Raises ValueError for what `run_timestep` refuses, other than the settings of contacts."""
    if contactSolver == "soft-step" and closingOnly:
        raise ValueError("closingOnly has no meaning for soft-step: no contact ever pulls")
    try:
        isWhole = substeps == int(substeps) and substeps >= 1
    except (TypeError, ValueError, OverflowError):  # None, NaN, infinity
        isWhole = False
    if not isWhole:
        raise ValueError(f"substeps must be a whole number of 1 or more, not {substeps}")
    if not 0.0 <= timeStep < math.inf:
        raise ValueError(f"the time step must be finite and not negative, not {timeStep:g}")
    if not tolerance >= 0.0:
        raise ValueError(f"the tolerance must not be negative, not {tolerance:g}")
    for what, name, known in (
        ("broad phase", broadPhase, BROAD_PHASES),
        ("constraint scheduling", constraintScheduling, CONSTRAINT_SCHEDULINGS),
        ("contact solver", contactSolver, CONTACT_SOLVERS),
    ):
        if name not in known:
            raise ValueError(f"no {what} {name!r}; there are {', '.join(known)}")
