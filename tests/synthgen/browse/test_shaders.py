"""The page's shader has the numbers of the curve; in a browser, `test_views` compares."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import synthgen.browse
from assets_procedural.conventions import colour, first_curve


def test_the_shader_has_the_numbers_of_the_curve() -> None:
    text = (Path(synthgen.browse.__path__[0]) / "assets" / "shaders.js").read_text()
    response = text[text.index("vec3 response") : text.index("vec3 display")]
    found = [float(n) for n in re.findall(r"(?<![\w.])\d+\.?\d*(?:e-?\d+)?", response)]
    wanted = [
        *(0.0, colour.CLIP, 1.0, colour.DARKEST, colour.TOE, colour.PIVOT, colour.SHOULDER),
        *(1.0, colour.DEPTH, colour.BLACK, colour.RANGE, 1.0, colour.PALING, 6.0, 1.0),
    ]
    assert found == pytest.approx(wanted, rel=1e-12)
    shoulder = text[text.index("vec3 shoulder") : text.index("float largest")]
    for number in (first_curve.KNEE, first_curve.CLIP, first_curve.RATE):
        assert str(number) in shoulder
