"""[contact]: how contacts are modelled."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from carom.scene.schema.material import Coefficients
from carom.scene.schema.quantity import AnyReal, Count, Friction, Positive, Section
from carom.scene.units.dimension import TIME, VELOCITY

Sweeps = Literal["auto", "as-needed", "quick"]


class Sleep(Section):
    """[contact.sleep]: islands at rest are not computed until something disturbs them."""

    speed: Annotated[Positive, VELOCITY] = Field(
        description="m/s; bodies that move at most this fast, and turn at most ten times as fast, may fall asleep"
    )
    after: Annotated[Positive, TIME] = Field(0.5, description="s, for which all bodies of an island must be so slow")


class Contact(Section):
    """[contact]: how contacts are modelled."""

    enabled: Annotated[bool, Field(strict=True)] = Field(True, description="false: spheres pass through each other")
    restitution: AnyReal = Field(
        0.5, ge=0, le=1, description="rebound speed over approach speed, from 0 (no bounce) to 1 (elastic)"
    )
    static_friction: Friction = Field(0.6, description="Coulomb coefficient of a sticking contact; not negative")
    kinetic_friction: Friction = Field(
        0.4, description="Coulomb coefficient of a sliding contact, from 0 to static_friction"
    )
    solver: Literal["lasting", "staged"] = Field(
        "lasting",
        description="solver of resting contacts: warm-started impulses (lasting), or impulses that start from 0 "
        "in every step (staged)",
    )
    colouring: Literal["contacts", "bodies"] = Field(
        "contacts", description="graph colouring that finds contacts to solve in parallel: of contacts or of bodies"
    )
    stabilisation: Literal["split", "baumgarte", "none"] = Field(
        "split",
        description="how overlaps are corrected: by moving the bodies (split), by a velocity bias (baumgarte), or not "
        "at all (none)",
    )
    timing: Literal["auto", "end-of-step", "time-of-impact"] = Field(
        "auto",
        description="when impacts are resolved: at the end of their step, or at their own times within it; auto is "
        "time-of-impact, unless a step of the integrator is more than one drift (yoshida4, leapfrog-dkd)",
    )
    search: Literal["grid", "k-d-tree"] = Field(
        "grid", description="broad phase: a hierarchical grid, or a k-d tree with the same result, 2 to 8 times slower"
    )
    sweeps: Sweeps | Annotated[Count, Field(le=10_000)] = Field(
        "auto",
        description="solver iterations in a step: until the impulses converge (auto); until no contact changes by 3e-6 "
        "of a radius, cheaper for heaps at rest (as-needed); at most four of these, cheaper while heaps fall, with "
        "deeper overlaps (quick); or at most this many, up to 10000",
    )
    sleep: Sleep | None = Field(
        None,
        description="skip islands that lie still on something fixed until something disturbs them; none by default",
    )
    allow_overlap: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: explicit bodies may overlap at the start"
    )

    @model_validator(mode="before")
    @classmethod
    def _follow_the_given_friction(cls, data: Any) -> Any:
        """Adapt the default of one coefficient if it contradicts the other, which is given."""
        if not isinstance(data, dict):
            return data
        static, kinetic = data.get("static_friction"), data.get("kinetic_friction")
        if isinstance(static, (int, float)) and kinetic is None:
            return {**data, "kinetic_friction": min(0.4, static)}
        if isinstance(kinetic, (int, float)) and static is None:
            return {**data, "static_friction": max(0.6, kinetic)}
        return data

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        if self.kinetic_friction > self.static_friction:
            raise ValueError(
                f"kinetic_friction = {self.kinetic_friction:g} is above static_friction = {self.static_friction:g}; "
                "a sliding contact cannot resist more than a sticking one, so kinetic_friction must be the smaller"
            )
        return self

    @model_validator(mode="after")
    def _only_lasting_contacts_sleep(self) -> Self:
        if self.sleep is not None and self.solver != "lasting":
            raise ValueError(
                f'sleep needs impulses that last; leave it out, or set solver = "lasting" instead of "{self.solver}"'
            )
        return self

    @property
    def coefficients(self) -> Coefficients:
        """Those of bodies and planes without a material."""
        return Coefficients(self.restitution, self.static_friction, self.kinetic_friction)
