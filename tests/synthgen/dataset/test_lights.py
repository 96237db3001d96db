"""What dataset.json says of a shot's light, as columns of every manifest that is opened."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import duckdb
import pytest

from synthgen.dataset import lights, open_dataset
from synthgen.dataset.manifest import query

TYPES = {
    "environments": "VARCHAR[]",
    "environment_rotation": "DOUBLE[]",
    "environment_exposure": "DOUBLE[]",
    "exposures": "DOUBLE[]",
}
SKY = {"id": "sky", "kind": "sky", "parameters": {"sun_azimuth": 170.0, "sun_elevation": 30.0}}
STUDIO = {
    "id": "studio",
    "kind": "studio",
    "parameters": {
        "lights": [
            {"azimuth": 10, "elevation": 5, "irradiance": 0.2, "kelvin": 3000},
            {"azimuth": -40, "elevation": 45, "irradiance": 1.0, "kelvin": 5500},
        ]
    },
}


def ask(environments: Any, use: str, rotation: float, exposure: float = 0.5, factor: float = 4.0):
    found = lights.columns(environments, TYPES)
    row = f"['{use}'] AS environments, [{rotation}]::DOUBLE[] AS environment_rotation, "
    row += f"[{exposure}]::DOUBLE[] AS environment_exposure, [{factor}]::DOUBLE[] AS exposures"
    with duckdb.connect() as connection:
        connection.execute(f"SELECT {', '.join(found.values())} FROM (SELECT {row})")
        (values,) = connection.fetchall()
    return dict(zip(found, values, strict=True))


def test_a_key_is_turned_with_its_panorama():
    found = ask([SKY, STUDIO], "sky", math.radians(30))
    assert found["light_kind"] == "sky" and found["light_kelvin"] is None
    assert found["light_azimuth"] == pytest.approx(math.radians(-160), abs=1e-4)
    assert found["light_elevation"] == pytest.approx(math.radians(30), abs=1e-4)
    assert found["light_brightness"] == pytest.approx(0.5 - 2)
    found = ask([SKY, STUDIO], "studio", 0)
    assert found["light_azimuth"] == pytest.approx(math.radians(-40), abs=1e-4)
    assert found["light_kelvin"] == 5500


@pytest.mark.parametrize(
    "entry",
    [
        {"id": "odd"},
        {"id": "odd", "kind": 3, "parameters": "x"},
        {"id": "odd", "kind": "it's", "parameters": {"lights": [1, {"irradiance": "much"}]}},
        {"id": "odd", "kind": "sky", "parameters": {"sun_azimuth": float("inf")}},
    ],
)
def test_what_strangers_write_is_null_or_text(entry: dict[str, Any]):
    found = ask([entry, SKY], "odd", 0, factor=0)
    assert found["light_azimuth"] is None and found["light_brightness"] is None
    assert found["light_kind"] in (None, "it's", "sky")
    assert ask([entry, SKY], "unknown", 0)["light_kind"] is None


def test_manifests_without_these_facts_are_left_alone():
    assert lights.columns([SKY], TYPES | {"exposures": "VARCHAR"}) == {}
    assert lights.columns("nonsense", TYPES) == {}
    assert "light_kind" not in lights.columns([SKY], TYPES | {"light_kind": "VARCHAR"})


def test_every_reader_has_them(small_dataset: Path):
    rows = query(small_dataset, "SELECT light_kind, light_brightness FROM multiview").rows
    assert {kind for kind, _ in rows} == {"bundled"} and all(b is not None for _, b in rows)
    assert len(open_dataset(small_dataset, where="light_kind = 'bundled'")) == 16
