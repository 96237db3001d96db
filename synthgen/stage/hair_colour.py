"""Strand colours from pigments: absorption of melanins, turned into the fibre's reflectance."""

from __future__ import annotations

import numpy as np

from assets_procedural.body.piece import StrandPiece

# Absorption of eumelanin and pheomelanin per unit concentration (d'Eon et al. 2011).
_EUMELANIN = np.array([0.506, 0.841, 1.653])
_PHEOMELANIN = np.array([0.343, 0.733, 1.924])
# White hair among its like scatters on: brighter fibres would make a glowing cloud of it.
_WHITE = np.array([0.46, 0.45, 0.425])
_BRIGHTEST = 0.72
# What the core of a fibre scatters at once, whatever its pigment: black hair is no coal, and its
# strands differ.
_CORE = np.array([0.016, 0.0125, 0.0105])


def strand_colours(piece: StrandPiece) -> np.ndarray:
    """(N, K, 4) linear colours at the points of a piece's strands.

    The piece's parameters: `melanin` and `redness` in [0, 1], `grey` the share of unpigmented
    hairs, `radial_roughness`, `strand_random` (N,) in [0, 1), one independent number a strand.
    Optional: `tone` (N,) multiplies the amount of pigment, `bleached` (N,) in [0, 1] is how much
    less of it the tips have, `dye` is a colour that begins `regrowth` (N,), a share of the strand,
    above the root; dyed hair needs a `tone`.
    """
    p = piece.parameters
    chance = np.asarray(p["strand_random"], float)
    along = np.linspace(0, 1, piece.radius.shape[1])
    # Concentration of Chiang et al. 2016, eq. 7-8 with the look-up -ln(1 - m).
    amount = -np.log(np.maximum(1 - np.clip(p["melanin"], 0, 0.995), 1e-4))
    amount = amount * (0.9 + 0.2 * _fraction(chance * 7.0)) * p.get("tone", 1.0)
    bleached = np.asarray(p.get("bleached", 0.0))[..., None] * along**2
    amount = (amount[:, None] * (1 - 0.85 * bleached))[..., None]
    sigma = amount * ((1 - p["redness"]) * _EUMELANIN + p["redness"] * _PHEOMELANIN)
    roughness = p["radial_roughness"]
    width = 5.969 + roughness * (
        -0.215
        + roughness * (2.532 + roughness * (-10.73 + roughness * (5.574 + 0.245 * roughness)))
    )
    colour = np.exp(-np.sqrt(sigma) * width)
    core = _CORE / np.maximum(np.asarray(p.get("tone", 1.0), float), 0.25)[..., None, None]
    colour = colour + (1 - colour) * core
    # Grey comes hair by hair, and a hair that greys is nearly white.
    grey = (np.clip((p["grey"] - chance) / 0.08 + 0.5, 0, 1) * (p["grey"] > 0))[:, None, None]
    white = _WHITE * (0.7 + 0.3 * _fraction(chance * 13.0))[:, None, None]
    colour = colour + grey * (white - colour)
    if "dye" in p:
        shade = np.asarray(p["tone"])[:, None, None]
        dye = np.asarray(p["dye"]) ** np.clip(shade, 0.6, 1.6)
        covered = np.clip((along - p["regrowth"][:, None]) / 0.08 + 0.5, 0, 1)[..., None]
        colour = colour + covered * (dye - colour)
    opaque = np.ones((*colour.shape[:2], 1))
    return np.concatenate([np.minimum(colour, _BRIGHTEST), opaque], axis=2)


def _fraction(x: np.ndarray) -> np.ndarray:
    return x - np.floor(x)
