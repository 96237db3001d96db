"""A library of plausible facial actions: moods, speech and their left-right imbalance.

Names are ARKit's; a name without Left or Right stands for both sides.
"""

from __future__ import annotations

import numpy as np

Actions = dict[str, float]

MOODS: dict[str, Actions] = {
    "neutral": {},
    "soft_smile": {
        "mouthSmile": 0.45, "mouthDimple": 0.12, "cheekSquint": 0.18, "eyeSquint": 0.12,
    },
    "smile": {"mouthSmile": 0.8, "cheekSquint": 0.4, "eyeSquint": 0.2, "mouthDimple": 0.2},
    "grin": {
        "mouthSmile": 0.95, "cheekSquint": 0.55, "eyeSquint": 0.35, "jawOpen": 0.08,
        "mouthUpperUp": 0.85, "mouthLowerDown": 0.5, "mouthStretch": 0.15,
    },
    "laugh": {
        "mouthSmile": 1.0, "cheekSquint": 0.8, "eyeSquint": 0.6, "jawOpen": 0.4,
        "mouthUpperUp": 0.8, "mouthLowerDown": 0.5, "browOuterUp": 0.2, "noseSneer": 0.1,
    },
    "amused": {
        "mouthSmileLeft": 0.48, "mouthSmileRight": 0.34, "mouthPress": 0.15, "cheekSquint": 0.2,
        "eyeSquint": 0.15, "browOuterUp": 0.12,
    },
    "smirk": {
        "mouthSmileLeft": 0.75, "mouthSmileRight": 0.1, "mouthDimpleLeft": 0.4, "mouthLeft": 0.12,
        "cheekSquintLeft": 0.35, "browOuterUpLeft": 0.2, "eyeSquint": 0.15,
    },
    "attentive": {
        "browOuterUp": 0.25, "browInnerUp": 0.12, "eyeWide": 0.2, "mouthSmile": 0.12,
        "mouthShrugUpper": 0.05,
    },
    "speechless": {"jawOpen": 0.1, "browOuterUp": 0.2, "mouthFunnel": 0.1, "eyeWide": 0.15},
    "concentrated": {"browDown": 0.4, "eyeSquint": 0.4, "mouthPress": 0.3, "mouthRollLower": 0.15},
    "pensive": {"mouthPucker": 0.25, "mouthLeft": 0.25, "browDown": 0.15, "mouthShrugLower": 0.2},
    "tired": {"eyeBlink": 0.3, "browInnerUp": 0.12, "browOuterUp": 0.1, "mouthShrugLower": 0.1},
    "surprised": {
        "browInnerUp": 0.8, "browOuterUp": 0.85, "eyeWide": 0.75, "jawOpen": 0.35,
        "mouthFunnel": 0.15,
    },
    "doubtful": {
        "browOuterUpRight": 0.7, "browInnerUp": 0.15, "browDownLeft": 0.35, "eyeSquintLeft": 0.3,
        "mouthPress": 0.25, "mouthLeft": 0.2, "mouthFrownLeft": 0.15,
    },
    "worried": {
        "browInnerUp": 0.75, "browDown": 0.3, "mouthStretch": 0.2, "mouthRollLower": 0.3,
        "mouthPress": 0.2,
    },
    "sad": {
        "browInnerUp": 0.85, "browDown": 0.2, "mouthFrown": 0.65, "mouthShrugLower": 0.35,
        "eyeSquint": 0.2, "eyeBlink": 0.15, "mouthPress": 0.15,
    },
    "crying": {
        "browInnerUp": 0.8, "browDown": 0.45, "eyeSquint": 0.7, "cheekSquint": 0.5,
        "mouthFrown": 0.6, "mouthStretch": 0.45, "jawOpen": 0.15, "mouthLowerDown": 0.3,
    },
    "angry": {
        "browDown": 0.95, "eyeSquint": 0.4, "noseSneer": 0.4, "mouthPress": 0.45,
        "mouthFrown": 0.3, "jawForward": 0.2, "mouthShrugUpper": 0.15,
    },
    "shouting": {
        "browDown": 0.8, "noseSneer": 0.5, "eyeSquint": 0.3, "jawOpen": 0.55, "mouthUpperUp": 0.45,
        "mouthLowerDown": 0.5, "mouthStretch": 0.35, "cheekSquint": 0.3,
    },
    "afraid": {
        "browInnerUp": 0.9, "browOuterUp": 0.4, "browDown": 0.25, "eyeWide": 0.85,
        "mouthStretch": 0.5, "jawOpen": 0.2, "mouthLowerDown": 0.25,
    },
    "disgusted": {
        "noseSneer": 0.85, "browDown": 0.5, "eyeSquint": 0.4, "mouthUpperUp": 0.5,
        "cheekSquint": 0.4, "mouthShrugLower": 0.3, "mouthFrown": 0.25,
    },
    "contempt": {
        "mouthDimpleRight": 0.6, "mouthSmileRight": 0.3, "mouthPressRight": 0.35, "eyeBlink": 0.12,
        "browDown": 0.15, "mouthRight": 0.15,
    },
    "pout": {
        "mouthPucker": 0.5, "mouthShrugLower": 0.55, "browInnerUp": 0.35, "mouthFrown": 0.3,
        "browDown": 0.2,
    },
    "kiss": {"mouthPucker": 0.9, "mouthFunnel": 0.2, "eyeSquint": 0.2, "eyeBlink": 0.2},
    "puffed": {"cheekPuff": 0.9, "mouthPress": 0.5, "browOuterUp": 0.25},
    "grimace": {
        "mouthStretch": 0.8, "mouthLowerDown": 0.45, "mouthUpperUp": 0.25, "eyeSquint": 0.5,
        "browDown": 0.35, "cheekSquint": 0.3,
    },
    "wink": {"eyeBlinkLeft": 0.95, "cheekSquintLeft": 0.6, "mouthSmileLeft": 0.5,
             "mouthSmileRight": 0.25, "browDownLeft": 0.2},
    "tongue": {"tongueOut": 0.8, "jawOpen": 0.35, "mouthSmile": 0.25, "mouthLowerDown": 0.2},
    "yawn": {"jawOpen": 0.8, "eyeBlink": 0.65, "browInnerUp": 0.4, "browOuterUp": 0.25,
             "mouthFunnel": 0.2, "noseSneer": 0.2},
}  # fmt: skip
"""What faces do, by the name of a mood, at full strength."""

EVERYDAY: dict[str, float] = {
    "neutral": 5.0, "soft_smile": 6.0, "smile": 2.6, "amused": 0.8, "attentive": 1.2, "grin": 0.8,
    "laugh": 0.4, "smirk": 0.2, "pensive": 0.2, "tired": 0.3, "concentrated": 0.4,
    "speechless": 0.15, "doubtful": 0.1, "surprised": 0.15, "contempt": 0.05, "worried": 0.1,
    "sad": 0.1, "angry": 0.08, "disgusted": 0.05, "afraid": 0.05, "pout": 0.05, "kiss": 0.05,
    "grimace": 0.05, "puffed": 0.03, "wink": 0.05, "yawn": 0.03,
}  # fmt: skip
"""Weights of moods as people show them to a camera."""

WIDE: dict[str, float] = {
    **{name: 1.0 for name in MOODS if name not in ("neutral", "soft_smile", "speechless")},
    "smile": 3.5, "grin": 2.5, "laugh": 1.2, "concentrated": 1.5, "smirk": 1.2, "tongue": 0.3,
    "wink": 0.4, "yawn": 0.4, "crying": 0.5, "puffed": 0.4, "kiss": 0.5,
}  # fmt: skip
"""Weights of moods that move every muscle, for what learns or is tested on expressions."""

VISEMES: dict[str, Actions] = {
    "m": {"mouthPress": 0.35, "mouthRollLower": 0.25, "mouthRollUpper": 0.2},
    "f": {"jawOpen": 0.08, "mouthRollLower": 0.5, "mouthUpperUp": 0.25},
    "sh": {"jawOpen": 0.1, "mouthFunnel": 0.4, "mouthUpperUp": 0.2, "mouthLowerDown": 0.3},
    "s": {"jawOpen": 0.06, "mouthStretch": 0.25, "mouthUpperUp": 0.15, "mouthLowerDown": 0.3},
    "l": {"jawOpen": 0.18, "mouthUpperUp": 0.15, "mouthLowerDown": 0.2},
    "k": {"jawOpen": 0.15, "mouthLowerDown": 0.12, "mouthStretch": 0.1},
    "r": {"jawOpen": 0.12, "mouthFunnel": 0.3, "mouthPucker": 0.2},
    "a": {"jawOpen": 0.38, "mouthLowerDown": 0.15, "mouthUpperUp": 0.08},
    "e": {"jawOpen": 0.22, "mouthStretch": 0.25, "mouthLowerDown": 0.2, "mouthUpperUp": 0.12},
    "i": {"jawOpen": 0.12, "mouthStretch": 0.35, "mouthSmile": 0.2, "mouthLowerDown": 0.2},
    "o": {"jawOpen": 0.28, "mouthFunnel": 0.5, "mouthPucker": 0.25},
    "u": {"jawOpen": 0.14, "mouthPucker": 0.7, "mouthFunnel": 0.3},
}
"""Mouth shapes of speech by a sound that they are seen with: "m" stands for b and p too."""
VOWELS = ("a", "e", "i", "o", "u")
CONSONANTS = tuple(name for name in VISEMES if name not in VOWELS)

_REST = {
    "mouthSmile": 0.35, "mouthPress": 0.1, "eyeSquint": 0.25, "browOuterUp": 0.25,
    "browInnerUp": 0.15, "mouthDimple": 0.12, "mouthShrugLower": 0.08, "cheekSquint": 0.1,
    "mouthLeft": 0.06, "mouthRight": 0.06,
}  # fmt: skip

_MOUTH = ("mouth", "jaw", "tongue", "cheekPuff")


def mouth_only(actions: Actions) -> Actions:
    return {name: value for name, value in actions.items() if name.startswith(_MOUTH)}


def without_mouth(actions: Actions) -> Actions:
    return {name: value for name, value in actions.items() if not name.startswith(_MOUTH)}


def blend(*parts: tuple[float, Actions]) -> Actions:
    """Weighted sum of actions, in the order of first mention."""
    total: Actions = {}
    for weight, actions in parts:
        for name, value in actions.items():
            total[name] = total.get(name, 0.0) + weight * value
    return total


def draw_mood(rng: np.random.Generator, weights: dict[str, float]) -> Actions:
    """What the face does: a mood by its weight, alone or mixed with a second one."""
    names = tuple(weights)
    chance = np.array([weights[name] for name in names])
    first, second = (names[k] for k in rng.choice(len(names), size=2, p=chance / chance.sum()))
    sides = rng.random(2) < 0.5
    one, other = (
        mirrored(MOODS[name]) if flip else MOODS[name]
        for name, flip in zip((first, second), sides, strict=True)
    )
    kind = rng.random()
    if kind < 0.7:
        return dict(one)
    if kind < 0.95:
        share = float(rng.uniform(0.2, 0.45))
        return blend((1.0 - share, one), (share, other))
    return blend((1.0, without_mouth(one)), (1.0, mouth_only(other)))


def draw_rest(rng: np.random.Generator) -> Actions:
    """The trace of tension that a relaxed face keeps; no face is ever quite at zero."""
    size = rng.beta(1.2, 4.0, len(_REST))
    return {name: float(most * s) for (name, most), s in zip(_REST.items(), size, strict=True)}


def mirrored(actions: Actions) -> Actions:
    """Left and right exchanged."""
    swap = {"Left": "Right", "Right": "Left"}
    out: Actions = {}
    for name, value in actions.items():
        side = next((s for s in swap if name.endswith(s)), None)
        out[name if side is None else name.removesuffix(side) + swap[side]] = value
    return out


def resolve(
    actions: Actions, names: tuple[str, ...], bias: dict[str, float] | None = None
) -> np.ndarray:
    """Actions to (len(names),) values in [0, 1] of ARKit names, free of contradictions.

    `bias` maps a base name ("mouthSmile") to the relative surplus of its left over its right side.

    Raises:
        KeyError: an action that ARKit does not name.
    """
    position = {name: index for index, name in enumerate(names)}
    out = np.zeros(len(names))
    for name, value in actions.items():
        if name in position:
            out[position[name]] += value
            continue
        surplus = (bias or {}).get(name, 0.0)
        out[position[name + "Left"]] += value * (1.0 + surplus)
        out[position[name + "Right"]] += value * (1.0 - surplus)
    at = {name: out[position[name]] for name in names}
    for side in ("Left", "Right"):
        # A closed lid is not wide open, and a squeezed eye needs less closing.
        wide = position["eyeWide" + side]
        out[wide] = at["eyeWide" + side] * max(0.0, 1.0 - 2.0 * at["eyeBlink" + side])
        blink = position["eyeBlink" + side]
        out[blink] = min(at["eyeBlink" + side], 1.0)
        # Lips cannot be pressed or rolled in on a mouth that is open.
        press = position["mouthPress" + side]
        out[press] = at["mouthPress" + side] * max(0.0, 1.0 - 3.0 * at["jawOpen"])
    for name in ("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthClose"):
        out[position[name]] = at[name] * max(0.0, 1.0 - 1.5 * at["jawOpen"])
    for one, other in (("jawLeft", "jawRight"), ("mouthLeft", "mouthRight")):
        shift = at[one] - at[other]
        out[position[one]], out[position[other]] = max(shift, 0.0), max(-shift, 0.0)
    return np.clip(out, 0.0, 1.0)
