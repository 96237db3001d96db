"""All pieces that go on a person's bust: eyes, mouth, clothes, accessories and hair."""

from __future__ import annotations

import numpy as np

from assets_procedural.body import eyes, mouth
from assets_procedural.body.head import Identity
from assets_procedural.body.piece import Piece
from assets_procedural.hair import beards, brows_and_lashes, scalp_hair
from assets_procedural.outfit import accessories, tops
from assets_procedural.person import Person


def pieces(person: Person, identity: Identity) -> list[Piece]:
    """All surfaces and strands of a person except the skin; deterministic in the person's seeds."""
    scalp = np.random.default_rng(person.hair.seed)
    brows = np.random.default_rng(person.brows.seed)
    beard = np.random.default_rng(person.beard.seed)
    return [
        *eyes.eyes(person, identity),
        *mouth.mouth(person, identity),
        *tops.wardrobe(person, identity),
        *accessories.accessories(person, identity),
        *scalp_hair.scalp_hair(person, identity, scalp),
        *brows_and_lashes.brows(person, identity, brows),
        *brows_and_lashes.lashes(person, identity, brows),
        *beards.beard(person, identity, beard),
    ]
