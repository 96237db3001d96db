"""`PeopleSettings`: what a job may say about its people."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, field_validator, model_validator

from assets_procedural.hair.beard_styles import BEARD_STYLES
from assets_procedural.hair.styles import STYLES
from assets_procedural.people.ages import AGE_GROUPS
from assets_procedural.people.ancestry import FAMILIES, AncestryGroup
from assets_procedural.people.appearance_sampling import HAIR_COLOURS, HairStyle
from assets_procedural.people.choices import Attribute
from assets_procedural.settings import Interval, Settings, interval

Weight = Annotated[float, Field(ge=0.0, le=1e6)]
Tables = dict[Attribute, dict[str, float]]
Share = Annotated[float, Field(ge=0.0, le=1.0)]

VALUES: dict[Attribute, tuple[str, ...]] = {
    "sex": ("male", "female"),
    "age_group": tuple(AGE_GROUPS),
    "ancestry": get_args(AncestryGroup),
    "hair_style": tuple(STYLES),
    "hair_colour": HAIR_COLOURS,
    "beard": BEARD_STYLES,
    "glasses": ("none", "clear", "sunglasses"),
    "hat": ("none", "worn"),
}
"""The values that weights and quotas may name, by attribute."""


class PeopleSettings(Settings):
    """Distribution of people. Probabilities in [0, 1], intervals (low, high)."""

    age: Annotated[Interval, interval(3.0, 95.0, "years")] = (18.0, 85.0)
    """Years; drawn from a flattened age pyramid over this interval."""
    male: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of men."""
    ancestry: dict[str, Weight] = Field(
        default_factory=lambda: dict.fromkeys(VALUES["ancestry"], 1.0)
    )
    """Relative weights of ancestries; those that are not named do not occur. "asian" and
    "caucasian" stand for several."""
    mixed: float = Field(default=0.25, ge=0.0, le=1.0)
    """Share of people of clearly mixed ancestry."""
    shape: float = Field(default=1.0, ge=0.0, le=1.5)
    """Strength of individual head and face shape; 0 gives average faces, 1 is natural."""
    asymmetry: float = Field(default=1.0, ge=0.0, le=2.0)
    """Strength of facial asymmetry; 0 is symmetric, 1 natural."""
    glasses: float = Field(default=0.2, ge=0.0, le=1.0)
    """Probability of glasses for a young adult; older people get them more often."""
    sunglasses: float = Field(default=0.05, ge=0.0, le=1.0)
    """Share of glasses that are strongly tinted."""
    hat: float = Field(default=0.06, ge=0.0, le=1.0)
    """Probability of a hat."""
    earrings: float = Field(default=0.35, ge=0.0, le=1.0)
    """Probability of earrings for a woman; men get a seventh of it, children a third."""
    beard: float = Field(default=0.5, ge=0.0, le=1.0)
    """Probability of visible facial hair, stubble included, for an adult man."""
    hair_styles: Literal["all"] | tuple[HairStyle, ...] = "all"
    """Scalp hair styles that may occur: "all" or a list of names."""
    weights: dict[Attribute, dict[str, Weight]] = Field(default_factory=dict)
    """How much more often than by nature a value occurs, by attribute: {hair_style = {afro = 3}};
    0 is never."""
    quotas: dict[Attribute, dict[str, Share]] = Field(default_factory=dict)
    """The share of all people that have a value, by attribute: {sex = {male = 0.5}}. The rest is
    drawn from the values that are not named, and the shares of any first n people are near."""

    @field_validator("ancestry")
    @classmethod
    def _ancestry(cls, value: dict[str, float]) -> dict[str, float]:
        known = (*VALUES["ancestry"], *FAMILIES)
        for name in value:
            if name not in known:
                raise ValueError(f'no ancestry is called "{name}"; choose from {", ".join(known)}')
        if sum(value.values()) <= 0.0:
            raise ValueError("at least one ancestry must have a weight above 0")
        return value

    @field_validator("weights", "quotas")
    @classmethod
    def _values(cls, tables: Tables) -> Tables:
        for attribute, table in tables.items():
            for name in table:
                if name not in VALUES[attribute]:
                    known = ", ".join(VALUES[attribute])
                    raise ValueError(f'{attribute} has no value "{name}"; choose from {known}')
        return tables

    @field_validator("quotas")
    @classmethod
    def _shares(cls, tables: Tables) -> Tables:
        for attribute, table in tables.items():
            total = sum(table.values())
            if total > 1.0 + 1e-9:
                raise ValueError(f"the shares of {attribute} add up to {total:g}; lower them to 1")
            if set(table) == set(VALUES[attribute]) and total < 1.0 - 1e-6:
                raise ValueError(
                    f"the shares of {attribute} add up to {total:g} and name every value; "
                    "raise them to 1, or leave one out"
                )
        return tables

    @model_validator(mode="after")
    def _hair(self) -> PeopleSettings:
        if self.hair_styles != "all":
            if not self.hair_styles:
                raise ValueError('hair_styles is empty; list at least one style or say "all"')
            if len(set(self.hair_styles)) != len(self.hair_styles):
                raise ValueError("hair_styles names a style twice")
        return self

    def ancestry_weights(self) -> dict[str, float]:
        """Relative weight of each ancestry, 0 where it does not occur."""
        weights = dict.fromkeys(VALUES["ancestry"], 0.0)
        for name, weight in self.ancestry.items():
            members = FAMILIES.get(name, (name,))
            for member in members:
                weights[member] += weight / len(members)
        return weights
