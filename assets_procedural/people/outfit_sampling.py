"""Clothes and accessories of a subject, and what goes with what."""

from __future__ import annotations

from typing import Any

import numpy as np

from assets_procedural.conventions.colour import srgb_decode
from assets_procedural.people.choices import chosen, clipped, draw_seed
from assets_procedural.person import (
    Colour,
    Earrings,
    Glasses,
    Hat,
    Headphones,
    Jacket,
    Necklace,
    Scarf,
    Top,
)

# Wardrobes are mostly black, navy, grey, white and earth; bright colours are rare.
_SOBER = (
    "#131416", "#1b1c20", "#232529", "#33363b", "#1a2233", "#202c45", "#2b3a55", "#4a4e54",
    "#6f7277", "#8f9194", "#b9b9b6", "#e9e7e1", "#f1efe9", "#f4f3f0", "#e2d9c8", "#c7b79c",
    "#8d7556", "#5d4733", "#3e2f25", "#4b5140", "#333b30", "#5a1f27",
)  # fmt: skip
_MUTED = (
    "#5b7794", "#8fa6bd", "#6d7f62", "#94a188", "#a4574a", "#c08468", "#b9894a", "#7a3b4a",
    "#574b6b", "#b0848c", "#34605f", "#d5b9ad",
)  # fmt: skip
_BRIGHT = ("#b3202a", "#d9962a", "#1f5fa8", "#1d7d56", "#d2522c", "#c8417a", "#e0c53a", "#3fa3a8")
_DENIM = ("#1c2942", "#2a3d5c", "#41597b", "#6d87a6", "#23262c", "#8ba0b8")
_HIDE = ("#111112", "#161413", "#2b1c14", "#4a2f20", "#5b3a26", "#20242c")
_SUIT = ("#14161a", "#1b2130", "#232a3a", "#2e3136", "#45484d", "#6b6a67", "#8a7a63", "#4a3b30")
_LENSES = ("#6b6f73", "#6b6f73", "#7a5a3c", "#8a6a45", "#4f6652", "#4c617d", "#8c5f6a")
_BEADS = ("#efe9dd", "#f2efe8", "#1c1c1e", "#7a2f2a", "#2f5a52", "#b08d57")
_FABRICS: dict[str, dict[str, float]] = {
    "crew": {"jersey": 5.5, "sweat": 2, "knit": 2, "cable": 0.6, "rib": 0.5},
    "loose": {"jersey": 2, "sweat": 1, "knit": 0.6},
    "scoop": {"jersey": 2, "rib": 1, "silk": 0.5},
    "boat": {"jersey": 2, "rib": 1, "knit": 1},
    "vee": {"jersey": 2, "knit": 2, "silk": 0.3},
    "henley": {"jersey": 2, "rib": 1},
    "polo": {"jersey": 1},
    "shirt": {"poplin": 3, "flannel": 1, "denim": 0.6, "silk": 0.4},
    "buttoned": {"poplin": 3, "flannel": 0.5},
    "band": {"poplin": 1, "silk": 0.3},
    "mock": {"rib": 1, "jersey": 1},
    "turtleneck": {"rib": 2, "knit": 1, "cable": 0.5},
    "hood": {"sweat": 1},
    "quarter_zip": {"fleece": 1, "sweat": 1, "knit": 0.5},
}
_PATTERNS: dict[str, dict[str, float]] = {
    "jersey": {
        "plain": 6, "heather": 1.2, "stripes": 0.7, "breton": 0.6, "ringer": 0.4, "print": 0.4,
        "block": 0.3,
    },
    "sweat": {"plain": 5, "heather": 2.5, "block": 0.4},
    "fleece": {"plain": 4, "heather": 1},
    "knit": {"plain": 5, "heather": 1, "stripes": 0.6, "gradient": 0.2, "block": 0.3},
    "cable": {"plain": 4, "heather": 1},
    "rib": {"plain": 5, "stripes": 0.4},
    "poplin": {"plain": 5, "pinstripe": 1.2, "check": 0.8, "dots": 0.3, "print": 0.4},
    "flannel": {"tartan": 2.5, "plain": 0.8, "check": 0.8},
    "denim": {"plain": 1},
    "silk": {"plain": 4, "dots": 0.5, "print": 1},
}  # fmt: skip
# Hair that lies flat enough for a band over it.
_SLEEK = ("bald", "buzz", "crop", "receding", "short", "side_part", "pixie")
_METALS: tuple[Colour, ...] = ((0.8, 0.6, 0.25), (0.75, 0.75, 0.77), (0.72, 0.45, 0.33))
_FRAMES = ("#17171a", "#17171a", "#4a2f1d", "#6e4524", "#1f2a44", "#6b2737", "#7d7f83", "#c9b79c")


def _linear(colour: str) -> Colour:
    """'#rrggbb' (sRGB) to linear Rec.709."""
    encoded = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    red, green, blue = (round(float(value), 4) for value in srgb_decode(encoded))
    return red, green, blue


def _colours(rng: np.random.Generator, fabric: str) -> tuple[Colour, Colour]:
    """Colour and accent of a garment, two that can be told apart."""
    special = {"denim": _DENIM, "leather": _HIDE, "suiting": _SUIT}.get(fabric)
    kinds = (_SOBER, _MUTED, _BRIGHT)
    main = kinds[rng.choice(3, p=[0.68, 0.24, 0.08])]
    main = main if special is None else special
    colour = np.array(_linear(str(main[rng.integers(len(main))])))
    colour *= np.exp(rng.normal(0, 0.08))
    accents = [_linear(c) for c in _SOBER + _MUTED]
    far = [a for a in accents if abs(np.cbrt(np.mean(a)) - np.cbrt(colour.mean())) > 0.25]
    accent = far[rng.integers(len(far))]
    red, green, blue = (round(float(c), 4) for c in colour.clip(0.003, 0.9))
    return (red, green, blue), accent


def draw_clothes(
    rng: np.random.Generator, age: float, male: bool, hat: Hat | None, hair: str
) -> dict[str, Any]:
    """Top, jacket, scarf, necklace and headphones that go together and with what is on the head."""
    top = draw_top(rng, age, male)
    jacket = draw_jacket(rng, top, age, male)
    scarf = draw_scarf(rng, top, jacket)
    necklace = draw_necklace(rng, top, male)
    headphones = draw_headphones(rng, age, hat is None and hair in _SLEEK)
    if hat is not None and hat.style == "headscarf":
        scarf = necklace = None
        if top.neckline == "hood":
            top = top.model_copy(update={"neckline": "crew"})
    if scarf is not None:
        necklace = None
    return {
        "top": top, "jacket": jacket, "scarf": scarf, "necklace": necklace,
        "headphones": headphones,
    }  # fmt: skip


def draw_top(rng: np.random.Generator, age: float, male: bool) -> Top:
    """Neckline, fabric, closure, colours and pattern of a top."""
    young = float(np.interp(age, [20.0, 45.0, 75.0], [1.6, 1.0, 0.4]))
    necklines = {
        "crew": 2.6, "loose": 0.9, "scoop": 0.15 if male else 1.1, "boat": 0.0 if male else 0.7,
        "vee": 1.0, "henley": 0.5, "polo": 1.0 if male else 0.35, "shirt": 1.7 if male else 1.1,
        "buttoned": 0.6 if male else 0.25, "band": 0.25, "mock": 0.4, "turtleneck": 0.7,
        "hood": 1.2 * young, "quarter_zip": 0.5,
    }  # fmt: skip
    neckline = chosen(rng, necklines)
    fabric = chosen(rng, _FABRICS[neckline])
    pattern = chosen(rng, _PATTERNS[fabric])
    if pattern == "ringer" and neckline not in ("crew", "loose", "vee", "scoop"):
        pattern = "plain"
    closure = "zip" if neckline == "quarter_zip" else "none"
    if neckline in ("henley", "polo", "shirt", "buttoned", "band"):
        closure = "buttons"
    colour, accent = _colours(rng, fabric)
    return Top(
        neckline=neckline, fabric=fabric, closure=closure, pattern=pattern, colour=colour,
        accent=accent, seed=draw_seed(rng),
    )  # fmt: skip


def draw_jacket(rng: np.random.Generator, top: Top, age: float, male: bool) -> Jacket | None:
    """An open layer over the top, or none: what fits over its collar and fabric."""
    worn = rng.random() < 0.3
    style = chosen(rng, {
        "blazer": float(np.interp(age, [18, 35, 70], [0.5, 1.2, 1.2])),
        "cardigan": 0.5 if male else 1.0,
        "trucker": float(np.interp(age, [20, 60], [1.0, 0.4])),
        "biker": float(np.interp(age, [20, 60], [0.7, 0.2])),
        "bomber": float(np.interp(age, [20, 60], [0.9, 0.3])),
    })  # fmt: skip
    fabric = chosen(rng, {
        "blazer": {"suiting": 1.0}, "cardigan": {"knit": 0.8, "cable": 0.2},
        "trucker": {"denim": 0.8, "suiting": 0.2}, "biker": {"leather": 1.0},
        "bomber": {"nylon": 0.8, "sweat": 0.2},
    }[style])  # fmt: skip
    pattern = "plain"
    if style == "blazer":
        pattern = chosen(rng, {"plain": 0.75, "pinstripe": 0.12, "tartan": 0.05, "heather": 0.08})
    colour, accent = _colours(rng, fabric)
    seed = draw_seed(rng)
    bulky = top.neckline in ("hood", "quarter_zip", "polo") or top.fabric in (
        "sweat", "fleece", "cable", "knit",
    )  # fmt: skip
    # A second shirt collar would fight with the first.
    doubled = style in ("trucker", "biker", "bomber") and top.closure == "buttons"
    if not worn or bulky or (doubled and top.neckline != "henley"):
        return None
    return Jacket(
        style=style, fabric=fabric, pattern=pattern, colour=colour, accent=accent, seed=seed
    )


def glasses_share(age: float, probability: float) -> float:
    """Share of people of an age that wear glasses, where `probability` of the young ones do."""
    # (1 - p)^k keeps 0 at 0 and 1 at 1 while older people wear glasses more often.
    exponent = float(np.interp(age, [5.0, 20.0, 40.0, 65.0], [0.4, 1.0, 1.2, 3.0]))
    return 1.0 - (1.0 - probability) ** exponent


def draw_glasses(
    rng: np.random.Generator, age: float, male: bool, probability: float, sunglasses: float
) -> Glasses | None:
    """Glasses or none; `sunglasses` is the share with tinted lenses."""
    worn = rng.random() < glasses_share(age, probability)
    tinted = bool(rng.random() < sunglasses)
    old = float(np.interp(age, [30.0, 65.0], [0.0, 1.0]))
    shape = chosen(rng, {
        "rectangle": 1.0 + 0.8 * old, "round": 0.9 - 0.4 * old, "oval": 0.4 + 0.4 * old,
        "wayfarer": 1.0 - 0.5 * old, "cat_eye": 0.04 if male else 0.7, "browline": 0.4,
        "rimless": 0.0 if tinted else 0.25 + 0.5 * old, "hexagon": 0.35 - 0.2 * old,
        "aviator": 0.9 if tinted else 0.3, "oversized": (0.1 if male else 0.5) + 0.4 * tinted,
    })  # fmt: skip
    share = {"aviator": 0.9, "round": 0.5, "oval": 0.5, "rectangle": 0.35, "hexagon": 0.85,
             "rimless": 1.0}.get(shape, 0.06)  # fmt: skip
    metal = bool(rng.random() < share)
    tortoise = bool(rng.random() < 0.25) and not metal
    frame = _linear(str(rng.choice(_FRAMES)))
    colour = _METALS[rng.integers(len(_METALS))] if metal else frame
    tint = rng.uniform(0.7, 0.92) if tinted else rng.uniform(0.0, 0.04)
    lens = _linear(str(rng.choice(_LENSES)))
    gradient = clipped(rng.uniform(0.3, 0.8)) if rng.random() < 0.4 else 0.0
    mirror = clipped(rng.uniform(0.25, 0.6)) if rng.random() < 0.2 else 0.0
    if not worn:
        return None
    return Glasses(
        shape=shape, colour=colour, metal=metal, tortoise=tortoise, tint=clipped(tint), lens=lens,
        gradient=gradient if tinted else 0.0, mirror=mirror if tinted else 0.0,
    )  # fmt: skip


def draw_earrings(
    rng: np.random.Generator, age: float, male: bool, probability: float, hat: Hat | None
) -> Earrings | None:
    """Earrings or none; a headscarf hides the ears."""
    share = 1.0 if age >= 16.0 else 1.0 / 3.0
    worn = rng.random() < probability * share * (1.0 / 7.0 if male else 1.0)
    kinds = {"stud": 0.7, "hoop": 0.3} if male else {"stud": 0.45, "hoop": 0.33, "drop": 0.22}
    shape = chosen(rng, kinds)
    size = {
        "stud": rng.uniform(3.0, 6.5),
        "hoop": np.exp(rng.uniform(np.log(11.0), np.log(20.0 if male else 40.0))),
        "drop": rng.uniform(12.0, 34.0),
    }[shape]
    colour = _METALS[rng.integers(len(_METALS))]
    if not worn or (hat is not None and hat.style == "headscarf"):
        return None
    return Earrings(shape=shape, size_mm=round(float(size), 2), colour=colour)


def draw_necklace(rng: np.random.Generator, top: Top, male: bool) -> Necklace | None:
    """A necklace where the neckline leaves room for one, or none."""
    worn = rng.random() < (0.1 if male else 0.45)
    style = chosen(rng, {"chain": 2.0} if male else {"chain": 1.0, "pendant": 1.2, "beads": 0.35})
    low = {"scoop": 1.0, "boat": 0.5, "vee": 0.8, "loose": 0.35, "shirt": 0.6}.get(top.neckline)
    drop = clipped(rng.uniform(0.1, 1.0) * (low or 0.0))
    metal = _METALS[rng.integers(len(_METALS))]
    bead = _linear(str(rng.choice(_BEADS)))
    if not worn or low is None:
        return None
    return Necklace(style=style, drop=drop, colour=bead if style == "beads" else metal)


def draw_hat(rng: np.random.Generator, age: float, male: bool, hair_fits: bool) -> Hat | None:
    """Headwear, for those who want some; over hair that no hat fits only a headscarf goes."""
    young = float(np.interp(age, [20.0, 60.0], [1.3, 0.7]))
    styles = {
        "beanie": 1.4 * young, "bobble": 0.5, "cap": 1.6 * young, "bucket": 0.5 * young,
        "fedora": 0.5, "sun_hat": 0.1 if male else 0.5, "turban": 0.3, "bandana": 0.35,
        "headscarf": 0.0 if male else 1.1,
    }  # fmt: skip
    style = chosen(rng, styles)
    colour, accent = _colours(rng, "knit")
    pattern = {
        "bandana": {"print": 0.5, "dots": 0.3, "plain": 0.2},
        "headscarf": {"plain": 0.75, "print": 0.12, "dots": 0.05, "gradient": 0.08},
        "bobble": {"plain": 0.5, "stripes": 0.5},
        "beanie": {"plain": 0.75, "heather": 0.25},
    }.get(style, {"plain": 1.0})  # fmt: skip
    hat = Hat(
        style=style, pattern=chosen(rng, pattern), colour=colour, accent=accent,
        seed=draw_seed(rng),
    )  # fmt: skip
    return hat if hair_fits or style == "headscarf" else None


def draw_scarf(rng: np.random.Generator, top: Top, jacket: Jacket | None) -> Scarf | None:
    """A scarf where no tall collar is in its way, or none."""
    worn = rng.random() < (0.16 if jacket is not None else 0.05)
    colour, accent = _colours(rng, "knit")
    scarf = Scarf(
        thickness_mm=round(float(rng.uniform(27, 40)), 1),
        fabric=chosen(rng, {"knit": 1.0, "flannel": 1.0, "cable": 0.4, "jersey": 0.6}),
        pattern=chosen(rng, {"plain": 3.0, "tartan": 1.2, "stripes": 0.5, "heather": 0.6}),
        colour=colour, accent=accent, seed=draw_seed(rng),
    )  # fmt: skip
    low = top.neckline in ("crew", "loose", "vee", "scoop", "henley")
    fits = jacket is None or jacket.style in ("cardigan", "blazer")
    return scarf if worn and low and fits else None


def draw_headphones(rng: np.random.Generator, age: float, fits: bool) -> Headphones | None:
    """Headphones or none; `fits`: nothing else is on the head and the hair lies flat."""
    worn = rng.random() < float(np.interp(age, [18.0, 60.0], [0.05, 0.01]))
    colour = _linear(str(rng.choice(("#101012", "#e6e4df", "#2a2d33", "#b9b3a6", "#3b2a26"))))
    accent = _linear(str(rng.choice(("#151517", "#5d5a55", "#2b2b2f"))))
    return Headphones(colour=colour, accent=accent) if worn and fits else None
