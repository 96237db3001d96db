"""The light of a shot as columns: what dataset.json says of its first panorama, turned as it was.

They are in no file: whoever opens a manifest gets them besides (`manifest.connect`).

    light_kind          "sky", "studio", "bundled", …
    light_brightness    stops: how bright it is on the face, before exposure
    light_azimuth       radians, where its sun or strongest lamp is: 0 in front of the trunk (-Y),
                        positive towards the subject's left (+X)
    light_elevation     radians above the horizon
    light_kelvin        colour temperature of the strongest lamp

What a panorama does not say of itself is NULL: photographed ones have neither place nor colour.
"""

from __future__ import annotations

import math
from typing import Any

from synthgen.dataset.database import literal
from synthgen.dataset.records import storable

_MOST = 5000  # panoramas
_NEEDED = {
    "environments": "VARCHAR[]",
    "environment_rotation": "DOUBLE[]",
    "environment_exposure": "DOUBLE[]",
    "exposures": "DOUBLE[]",
}


def columns(environments: Any, described: dict[str, str]) -> dict[str, str]:
    """SQL expressions by column, for a manifest with these columns and types; {} if it lacks some.

    `environments` are those of dataset.json. What a manifest has itself under one of these names is
    left alone.
    """
    if any(described.get(name) != kind for name, kind in _NEEDED.items()):
        return {}
    facts = dict(_facts(e) for e in _panoramas(environments))
    if not facts:
        return {}
    place = f"list_position({_list(facts)}, environments[1])"

    def of(fact: str) -> str:
        return f"({_list(each[fact] for each in facts.values())})[{place}]"

    turned = f"({of('azimuth')}::DOUBLE + environment_rotation[1])"
    found = {
        "light_kind": f"{of('kind')}::VARCHAR",
        "light_brightness": "CASE WHEN exposures[1] > 0 "
        "THEN round(environment_exposure[1] - log2(exposures[1]), 4) END",
        # Into [-pi, pi).
        "light_azimuth": f"round({turned} - 2 * pi() * floor({turned} / (2 * pi()) + 0.5), 5)",
        "light_elevation": f"{of('elevation')}::DOUBLE",
        "light_kelvin": f"{of('kelvin')}::DOUBLE",
    }
    return {name: text for name, text in found.items() if name not in described}


def _panoramas(listed: Any) -> list[dict[str, Any]]:
    entries = listed if isinstance(listed, list) else []
    named = [e for e in entries if isinstance(e, dict) and isinstance(e.get("id"), str)]
    return named[:_MOST]


def _facts(entry: dict[str, Any]) -> tuple[str, dict[str, str | float | None]]:
    """What an entry of dataset.json, which anybody may have written, says of a panorama."""
    kind = entry.get("kind")
    said = entry.get("parameters")
    parameters: dict[str, Any] = said if isinstance(said, dict) else {}
    azimuth, elevation, kelvin = (
        parameters.get("sun_azimuth"),
        parameters.get("sun_elevation"),
        None,
    )
    lamps = parameters.get("lights")
    lamps = [lamp for lamp in lamps if isinstance(lamp, dict)] if isinstance(lamps, list) else []
    if lamps:
        strongest = max(lamps, key=lambda lamp: _number(lamp.get("irradiance")) or 0.0)
        azimuth, elevation = strongest.get("azimuth"), strongest.get("elevation")
        kelvin = strongest.get("kelvin")
    return entry["id"], {
        "kind": kind if isinstance(kind, str) else None,
        "azimuth": _radians(azimuth),
        "elevation": _radians(elevation),
        "kelvin": _number(kelvin),
    }


def _number(value: Any) -> float | None:
    whole = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if whole and math.isfinite(value) else None


def _radians(degrees: Any) -> float | None:
    number = _number(degrees)
    return None if number is None else round(math.radians(number), 5)


def _list(values: Any) -> str:
    texts = [
        "NULL" if v is None else literal(storable(v)) if isinstance(v, str) else repr(v)
        for v in values
    ]
    return f"[{', '.join(texts)}]"
