"""The kind of person somebody is: what has named values that jobs weigh and count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.hair.styles import STYLES
from assets_procedural.people.ages import age_weights, draw_age
from assets_procedural.people.ancestry import Heritage, draw_heritage
from assets_procedural.people.appearance_sampling import draw_beard, draw_hair, draw_skin
from assets_procedural.people.choices import Choices
from assets_procedural.people.outfit_sampling import glasses_share
from assets_procedural.people.people_settings import PeopleSettings
from assets_procedural.person import Beard, Hair, Skin


@dataclass(frozen=True)
class Kind:
    """Who somebody is: what was chosen from named values, and what follows from it."""

    male: bool
    age_group: str
    age: float
    heritage: Heritage
    skin: Skin
    hair: Hair
    beard: Beard
    hat: bool
    glasses: str


def draw_kind(rng: np.random.Generator, settings: PeopleSettings, choices: Choices) -> Kind:
    """The part of a person that has named values, chosen by `choices`."""
    male = choices.pick("sex", rng, {"male": settings.male, "female": 1 - settings.male}) == "male"
    group = choices.pick("age_group", rng, age_weights(settings.age))
    age = draw_age(rng, group, settings.age)
    weights = settings.ancestry_weights()
    heritage = draw_heritage(rng, choices.pick("ancestry", rng, weights), weights, settings.mixed)
    skin = draw_skin(rng, age, male, heritage)
    allowed = tuple(STYLES) if settings.hair_styles == "all" else settings.hair_styles
    hat = choices.pick("hat", rng, {"none": 1 - settings.hat, "worn": settings.hat}) == "worn"
    hair = draw_hair(rng, age, male, heritage, skin.melanin, allowed, hat, choices)
    beard = draw_beard(rng, age, male, heritage, settings.beard, choices)
    worn = glasses_share(age, settings.glasses)
    dark = settings.sunglasses
    natural = {"none": 1 - worn, "clear": worn * (1 - dark), "sunglasses": worn * dark}
    glasses = choices.pick("glasses", rng, natural)
    return Kind(male, group, age, heritage, skin, hair, beard, hat, glasses)
