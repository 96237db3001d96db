"""`Person`: every parameter of a subject, plain data."""

from __future__ import annotations

from pydantic import Field

from assets_procedural.settings import Parameters

ADULT = 18.0
"""Age in years from which heads go bald and beards grow."""
Colour = tuple[float, float, float]
"""Linear Rec.709."""


class Skin(Parameters):
    """Unitless strengths in [0, 1]; `moles` is a count."""

    melanin: float = 0.3
    haemoglobin: float = 0.5
    freckles: float = 0.0
    moles: int = 0
    blemishes: float = 0.2
    wrinkles: float = 0.2
    oiliness: float = 0.4
    seed: int = 0


class Makeup(Parameters):
    """Strengths in [0, 1] of what is painted on; the colours are linear Rec.709."""

    lipstick: float = 0.0
    lip_colour: Colour = (0.35, 0.03, 0.04)
    eyeshadow: float = 0.0
    lid_colour: Colour = (0.12, 0.07, 0.05)
    blush: float = 0.0
    liner: float = 0.0


class Eyes(Parameters):
    """`iris` is linear Rec.709; `pupil_mm` the pupil's diameter."""

    iris: Colour = (0.12, 0.06, 0.03)
    limbus: float = 0.6
    pupil_mm: float = 3.5
    redness: float = 0.2
    seed: int = 0


class Hair(Parameters):
    """Texture, colour, cut and loss of scalp hair; without a unit in [0, 1].

    `parting` runs from -1 (subject's right) over 0 (centre) to 1 (left). `receding` is how far the
    hairline has gone back, `thinning` how bare the crown is, up to a horseshoe of hair. `dye`
    colours the hair but for `regrowth_mm` at the root; `tips` bleaches its ends.
    `colour` is the name of what the pigments look like: black, brown, blond, red or grey.
    """

    style: str = "short"
    colour: str = "brown"
    melanin: float = 0.8
    redness: float = 0.2
    grey: float = 0.0
    length: float = 0.5
    parting: float = 0.0
    curl: float = 0.0
    density: float = 0.8
    receding: float = 0.0
    thinning: float = 0.0
    dye: Colour | None = None
    regrowth_mm: float = 0.0
    tips: float = 0.0
    seed: int = 0


class Brows(Parameters):
    """`style` is a name of `brows_and_lashes.BROWS`, from which the rest departs.

    `height_mm` lifts the brow, `slope` its outer end (mm per mm), `arch_mm` the peak; `taper`
    thins the tail (below 0 the inner end), `start_mm` moves the inner end outwards. `thickness`
    and `density` are in [0, 1].
    """

    style: str = "natural"
    height_mm: float = 0.0
    slope: float = 0.0
    arch_mm: float = 0.0
    taper: float = 0.0
    start_mm: float = 0.0
    thickness: float = 0.5
    density: float = 0.6
    seed: int = 0


class Beard(Parameters):
    """`style`: none, or a name of `beard_styles.BEARDS`: stubble, moustache, goatee, full …"""

    style: str = "none"
    length_mm: float = 1.0
    density: float = 0.6
    seed: int = 0


class Top(Parameters):
    """What is worn next to the skin; `neckline`, `fabric` and `pattern` as in `outfit`.

    `closure`: none, buttons (a placket) or zip. `accent` colours patterns, ringer bands and trims.
    """

    neckline: str = "crew"
    fabric: str = "jersey"
    closure: str = "none"
    pattern: str = "plain"
    colour: Colour = (0.2, 0.25, 0.35)
    accent: Colour = (0.6, 0.6, 0.6)
    seed: int = 0


class Jacket(Parameters):
    """An open layer over the top: blazer, cardigan, trucker, biker or bomber."""

    style: str = "blazer"
    fabric: str = "suiting"
    pattern: str = "plain"
    colour: Colour = (0.02, 0.025, 0.04)
    accent: Colour = (0.1, 0.1, 0.12)
    seed: int = 0


class Scarf(Parameters):
    """Wound around the neck, over everything else; `thickness_mm` of the roll."""

    thickness_mm: float = 34.0
    fabric: str = "knit"
    pattern: str = "plain"
    colour: Colour = (0.2, 0.2, 0.22)
    accent: Colour = (0.5, 0.5, 0.5)
    seed: int = 0


class Glasses(Parameters):
    """`tint` is the share of light that a lens absorbs, `gradient` how much of it the lower edge
    loses, `mirror` the share of light that a coated lens throws back."""

    shape: str = "rectangle"
    colour: Colour = (0.03, 0.03, 0.03)
    metal: bool = False
    tortoise: bool = False
    tint: float = 0.0
    lens: Colour = (0.5, 0.5, 0.5)
    gradient: float = 0.0
    mirror: float = 0.0


class Earrings(Parameters):
    """`shape`: stud, hoop or drop."""

    shape: str = "hoop"
    size_mm: float = 18.0
    colour: Colour = (0.8, 0.6, 0.25)


class Necklace(Parameters):
    """`style`: chain, pendant or beads; `drop` from 0 (at the throat) to 1 (over the chest)."""

    style: str = "chain"
    drop: float = 0.4
    colour: Colour = (0.8, 0.6, 0.25)


class Hat(Parameters):
    """Headwear, headscarves included."""

    style: str = "beanie"
    pattern: str = "plain"
    colour: Colour = (0.15, 0.05, 0.06)
    accent: Colour = (0.5, 0.5, 0.5)
    seed: int = 0


class Headphones(Parameters):
    """Over the ears, with a band over the head."""

    colour: Colour = (0.02, 0.02, 0.02)
    accent: Colour = (0.3, 0.3, 0.3)


class Person(Parameters):
    """One subject.

    `sex` (male or female), `age_group` and `ancestry` name what was drawn first; `ancestry_mix` has
    the share of each ancestry, of sum 1. What follows from them, and is seen, is in the others:
    `phenotypes` are Anny's (gender 0 male to 1 female, age, muscle, weight, height, proportions,
    african, asian, caucasian …) in [0, 1]; `shape` its local changes in [-1, 1]; `asymmetry`
    MakeHuman's asymmetry targets in [0, 1].
    """

    sex: str = ""
    age_group: str = ""
    ancestry: str = ""
    ancestry_mix: dict[str, float] = Field(default_factory=dict)
    age_years: float = 35.0
    phenotypes: dict[str, float] = Field(default_factory=dict)
    shape: dict[str, float] = Field(default_factory=dict)
    asymmetry: dict[str, float] = Field(default_factory=dict)
    skin: Skin = Skin()
    makeup: Makeup = Makeup()
    eyes: Eyes = Eyes()
    hair: Hair = Hair()
    brows: Brows = Brows()
    beard: Beard = Beard()
    top: Top = Top()
    jacket: Jacket | None = None
    scarf: Scarf | None = None
    glasses: Glasses | None = None
    earrings: Earrings | None = None
    necklace: Necklace | None = None
    hat: Hat | None = None
    headphones: Headphones | None = None
