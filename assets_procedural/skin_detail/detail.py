"""What the skin shader reads besides vertices: a picture over the face, for one expression."""

from __future__ import annotations

import numpy as np

from assets_procedural.body.head import HeadModel
from assets_procedural.motion.expressions import Actions
from assets_procedural.person import Person
from assets_procedural.skin_detail.creases import Creases
from assets_procedural.skin_detail.marks import marks

# Absorbed at the bottom of a crease: light that comes in narrowly, and blood that shows.
_CAVITY = np.array([0.16, 0.25, 0.27], np.float32)
_CAVITY_DEPTH = 0.7e-3


class SkinDetail:
    """A person's creases and marks, made once."""

    def __init__(self, person: Person, model: HeadModel) -> None:
        self._creases = Creases(person.skin, model)
        self._absorbed, self._relief = marks(person, model)

    def picture(self, actions: Actions) -> np.ndarray:
        """(HEIGHT, WIDTH, 4) float32 of `chart`: absorbed light (linear RGB) and height, metres."""
        height = self._creases.height(actions)
        depth = np.clip(-height / _CAVITY_DEPTH, 0, 1)[..., None]
        absorbed = 1 - (1 - self._absorbed) * (1 - _CAVITY * depth)
        return np.concatenate([absorbed, (height + self._relief)[..., None]], axis=-1)
