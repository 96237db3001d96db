"""A library of plausible facial actions: expressions, speech and their left-right imbalance.

Names are ARKit's; a name without Left or Right stands for both sides.
"""

from __future__ import annotations

import numpy as np

Actions = dict[str, float]

EXPRESSIONS: dict[str, Actions] = {
    "smile": {"mouthSmile": 0.9, "cheekSquint": 0.4, "eyeSquint": 0.25, "mouthDimple": 0.2},
    "grin": {
        "mouthSmile": 1.0, "cheekSquint": 0.6, "eyeSquint": 0.4, "jawOpen": 0.12,
        "mouthUpperUp": 0.45, "mouthLowerDown": 0.3, "mouthStretch": 0.2,
    },
    "laugh": {
        "mouthSmile": 1.0, "cheekSquint": 0.8, "eyeSquint": 0.65, "jawOpen": 0.5,
        "mouthUpperUp": 0.5, "mouthLowerDown": 0.35, "browOuterUp": 0.2, "noseSneer": 0.15,
    },
    "smirk": {
        "mouthSmileLeft": 0.85, "mouthSmileRight": 0.1, "mouthDimpleLeft": 0.4, "mouthLeft": 0.15,
        "cheekSquintLeft": 0.35, "browOuterUpLeft": 0.2, "eyeSquint": 0.15,
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
    "surprised": {
        "browInnerUp": 0.8, "browOuterUp": 0.85, "eyeWide": 0.75, "jawOpen": 0.35,
        "mouthFunnel": 0.15,
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
    "sceptical": {
        "browOuterUpRight": 0.8, "browInnerUp": 0.2, "browDownLeft": 0.6, "eyeSquintLeft": 0.35,
        "mouthPress": 0.25, "mouthLeft": 0.2, "mouthFrownLeft": 0.25,
    },
    "focused": {"browDown": 0.55, "eyeSquint": 0.45, "mouthPress": 0.3, "mouthRollLower": 0.15},
    "worried": {
        "browInnerUp": 0.75, "browDown": 0.3, "mouthStretch": 0.2, "mouthRollLower": 0.3,
        "mouthPress": 0.2,
    },
    "pensive": {"mouthPucker": 0.3, "mouthLeft": 0.3, "browDown": 0.25, "mouthShrugLower": 0.25},
    "pout": {
        "mouthPucker": 0.5, "mouthShrugLower": 0.55, "browInnerUp": 0.35, "mouthFrown": 0.3,
        "browDown": 0.2,
    },
    "kiss": {"mouthPucker": 0.9, "mouthFunnel": 0.2, "eyeSquint": 0.2, "eyeBlink": 0.2},
    "puffed": {"cheekPuff": 0.9, "mouthPress": 0.5, "browOuterUp": 0.25},
    "sleepy": {"eyeBlink": 0.45, "browInnerUp": 0.3, "jawOpen": 0.06, "browOuterUp": 0.15},
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
"""Archetypes at full strength."""

_OFTEN = {"smile": 3.5, "grin": 2.5, "laugh": 1.2, "focused": 1.5, "smirk": 1.2}
_SELDOM = {"tongue": 0.3, "wink": 0.4, "yawn": 0.4, "crying": 0.5, "puffed": 0.4, "kiss": 0.5}
_NAMES = tuple(EXPRESSIONS)
_WEIGHTS = np.array([_OFTEN.get(name, _SELDOM.get(name, 1.0)) for name in _NAMES])
_WEIGHTS /= _WEIGHTS.sum()

VISEMES: tuple[Actions, ...] = (
    {"mouthPress": 0.35, "mouthRollLower": 0.25, "mouthRollUpper": 0.2},  # m, b, p
    {"jawOpen": 0.42, "mouthLowerDown": 0.2, "mouthUpperUp": 0.1},  # a
    {"jawOpen": 0.22, "mouthStretch": 0.3, "mouthLowerDown": 0.25, "mouthUpperUp": 0.15},  # e
    {"jawOpen": 0.12, "mouthStretch": 0.4, "mouthSmile": 0.2, "mouthLowerDown": 0.2},  # i
    {"jawOpen": 0.3, "mouthFunnel": 0.55, "mouthPucker": 0.25},  # o
    {"jawOpen": 0.14, "mouthPucker": 0.7, "mouthFunnel": 0.3},  # u, w
    {"jawOpen": 0.08, "mouthRollLower": 0.5, "mouthUpperUp": 0.25},  # f, v
    {"jawOpen": 0.1, "mouthFunnel": 0.4, "mouthUpperUp": 0.2, "mouthLowerDown": 0.3},  # sh, ch
    {"jawOpen": 0.18, "mouthUpperUp": 0.2, "mouthLowerDown": 0.2},  # l, d, t, n
)
"""Mouth shapes of speech."""

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


def draw_expression(rng: np.random.Generator) -> Actions:
    """One archetype, or two mixed, or the eyes of one with the mouth of another."""
    first = EXPRESSIONS[_NAMES[rng.choice(len(_NAMES), p=_WEIGHTS)]]
    second = EXPRESSIONS[_NAMES[rng.choice(len(_NAMES), p=_WEIGHTS)]]
    if rng.random() < 0.5:
        first, second = mirrored(first), mirrored(second)
    kind = rng.random()
    if kind < 0.55:
        return dict(first)
    if kind < 0.85:
        share = float(rng.uniform(0.35, 0.65))
        return blend((1.0 - share, first), (share, second))
    return blend((1.0, without_mouth(first)), (1.0, mouth_only(second)))


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
