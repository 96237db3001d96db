"""Strand colours from pigments: absorption of melanins, turned into the fibre's reflectance."""

from __future__ import annotations

import numpy as np

from assets_procedural.body.piece import StrandPiece

# Absorption of eumelanin and pheomelanin per unit concentration (d'Eon et al. 2011).
_EUMELANIN = np.array([0.506, 0.841, 1.653])
_PHEOMELANIN = np.array([0.343, 0.733, 1.924])
_WHITE = np.array([0.66, 0.64, 0.60])


def strand_colours(piece: StrandPiece) -> np.ndarray:
    """(N, 4) linear colours of a piece's strands: pigment, its scatter, and grey hairs.

    The piece's parameters: `melanin` and `redness` in [0, 1], `grey` the share of unpigmented
    hairs, `strand_random` (N,) in [0, 1), one independent number a strand.
    """
    p = piece.parameters
    chance = np.asarray(p["strand_random"], float)
    # Concentration of Chiang et al. 2016, eq. 7-8 with the look-up -ln(1 - m).
    amount = -np.log(np.maximum(1 - np.clip(p["melanin"], 0, 0.995), 1e-4))
    amount = amount * (0.8 + 0.4 * _fraction(chance * 7.0))[:, None]
    sigma = amount * ((1 - p["redness"]) * _EUMELANIN + p["redness"] * _PHEOMELANIN)
    roughness = p.get("radial_roughness", 0.45)
    width = 5.969 + roughness * (
        -0.215
        + roughness * (2.532 + roughness * (-10.73 + roughness * (5.574 + 0.245 * roughness)))
    )
    colour = np.exp(-np.sqrt(sigma) * width)
    # Grey comes hair by hair, and a hair that greys is nearly white.
    grey = np.clip((p["grey"] - chance) / 0.08 + 0.5, 0, 1)[:, None] * (p["grey"] > 0)
    colour = colour + grey * (_WHITE * (0.8 + 0.2 * _fraction(chance * 13.0))[:, None] - colour)
    return np.concatenate([np.clip(colour, 0.003, 0.9), np.ones((len(colour), 1))], axis=1)


def _fraction(x: np.ndarray) -> np.ndarray:
    return x - np.floor(x)
