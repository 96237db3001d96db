"""Croissant metadata: the manifests as tables, the shards as sets of files."""

from __future__ import annotations

from typing import Any

from synthgen.dataset.records import Description
from synthgen.publish.card import HERE, contents, totals
from synthgen.publish.licences import licence

# The specification's, of terms in its own vocabulary, which go by the same name with a prefix.
_TERMS = (
    *("arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field"),
    *("fileObject", "fileProperty", "fileSet", "format", "includes", "isArray", "isLiveDataset"),
    *("jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex"),
    *("repeated", "replace", "samplingRate", "separator", "source", "subField", "transform"),
)
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
} | {term: f"cr:{term}" for term in _TERMS}


def croissant(info: Description, people: int) -> dict[str, Any]:
    """Croissant 1.1 metadata: the manifests as tables, the shards as sets of files."""
    distribution: list[dict[str, Any]] = []
    records: list[dict[str, Any]] = []
    for subset in info.plan:
        table, tars = f"{subset}-manifest", f"{subset}-shards"
        path = HERE.relative(HERE.manifest(subset))
        distribution.append(
            {
                "@type": "cr:FileObject",
                "@id": table,
                "name": table,
                "contentUrl": path,
                "encodingFormat": "application/x-parquet",
                "sha256": info.files[path],
            }
        )
        distribution.append(
            {
                "@type": "cr:FileSet",
                "@id": tars,
                "name": tars,
                "encodingFormat": "application/x-tar",
                "includes": HERE.shards_pattern(subset),
            }
        )
        columns = [
            ("key", "sc:Text", "Key of the shot, unique in the subset"),
            ("subject", "sc:Text", "Subject"),
            ("split", "sc:Text", "Split, decided by a hash of the subject's seed"),
            ("shard", "sc:Text", "Shard that holds the shot"),
            ("offset", "sc:Integer", "First byte of the shot in its shard"),
            ("size", "sc:Integer", "Bytes of the shot in its shard"),
        ]
        records.append(
            {
                "@type": "cr:RecordSet",
                "@id": subset,
                "name": subset,
                "description": f"Shots of the subset {subset}",
                "key": {"@id": f"{subset}/key"},
                "field": [
                    {
                        "@type": "cr:Field",
                        "@id": f"{subset}/{name}",
                        "name": name,
                        "description": text,
                        "dataType": kind,
                        "source": {"fileObject": {"@id": table}, "extract": {"column": name}},
                    }
                    for name, kind, text in columns
                ],
            }
        )
    distribution.append(
        {
            "@type": "cr:FileSet",
            "@id": "environments",
            "name": "environments",
            "encodingFormat": "image/x-exr",
            "includes": HERE.panoramas_pattern(),
        }
    )
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": info.name,
        "description": f"{contents(totals(info).frames, people)} with geometry, masks, cameras "
        "and environments.",
        "license": licence(info)[1],
        "citeAs": f"{info.name}, rendered by synthgen {info.code['version']}",
        # Relative to this file: where the dataset will be published is not known here.
        "url": "README.md",
        "creator": {
            "@type": "sc:Organization",
            "name": f"synthgen {info.code['version']}",
        },
        "datePublished": info.created,
        "version": f"{info.format}.0.0",
        "isLiveDataset": False,
        "distribution": distribution,
        "recordSet": records,
    }
