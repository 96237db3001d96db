"""The dataset card: README.md with the header that the Hugging Face hub reads."""

from __future__ import annotations

from assets_procedural.conventions import console
from synthgen.dataset import passes
from synthgen.dataset.folder import DatasetFolder, brief
from synthgen.dataset.records import Counts, Description
from synthgen.planning.plan import SPLITS
from synthgen.publish.licences import licence

HERE = DatasetFolder(".")
"""The card lies in the folder, and names files from there."""

# member -> what it is
FIELDS = {
    "rgb_00.png": "Display-referred image under environment 00 (01, 02, … for the others)",
    "hdr_00.exr": "Linear Rec.709 premultiplied foreground, half float",
    **passes.contents(),
    "geometry.npz": "Control points posed and canonical, normals, joints, 3D landmarks",
    "meta.json": "Camera, environments, exposures, expression, pose, gaze, 2D landmarks, seeds; "
    "`person` is a JSON string",
}


def totals(info: Description) -> Counts:
    """Subjects, shots and frames of a complete dataset."""
    each = [split for subset in info.counts.values() for split in subset.values()]
    return Counts(
        subjects=sum(c.subjects for c in each),
        shots=sum(c.shots for c in each),
        frames=sum(c.frames for c in each),
    )


def contents(frames: int, people: int) -> str:
    """What a dataset holds, in words: 60 synthetic portraits of 5 people."""
    portraits = console.count(frames, "synthetic portrait")
    return f"{portraits} of {console.count(people, 'person', 'people')}"


def _splits(info: Description, subset: str) -> list[str]:
    return [s for s in SPLITS if info.counts[subset][s].shots]


def card(info: Description, people: int) -> str:
    """README.md with the YAML header that the Hugging Face hub reads: configs = subsets.

    `people` is how many different ones there are: fewer than subjects if subsets share them.
    """
    lines = ["---", f"license: {licence(info)[0]}", f"pretty_name: {info.name}", "tags:"]
    lines += ["- webdataset", "- synthetic", "- portraits", "- relighting"]
    lines += ["task_categories:", "- image-to-image", "configs:"]
    for subset in info.plan:
        lines += [f"- config_name: {subset}", "  data_files:"]
        for split in _splits(info, subset):
            lines += [f"  - split: {split}", f"    path: {HERE.shards_pattern(subset, split)}"]
    lines += ["---", "", f"# {info.name}", ""]
    job = info.job
    lines += [
        f"{contents(totals(info).frames, people)} at "
        f"{job['resolution']}², rendered by synthgen {info.code['version']} with seed "
        f"{job['seed']}. Every person is made of parameters; nobody is real.",
        "",
        *_selected(info),
        "| subset | kind | split | subjects | shots | images |",
        "|---|---|---|---:|---:|---:|",
    ]
    for subset, plan in info.plan.items():
        for split in _splits(info, subset):
            c = info.counts[subset][split]
            lines.append(
                f"| {subset} | {plan.kind} | {split} | {c.subjects} | {c.shots} | {c.frames} |"
            )
    if info.quarantined:
        failed = console.count(len(info.quarantined), "subject")
        lines += ["", f"Left out: {failed} that failed."]
    lines += ["", "## A sample", "", "| field | content |", "|---|---|"]
    lines += [f"| `{name}` | {text} |" for name, text in _fields(info).items()]
    first = next(iter(info.plan))
    split = next(iter(_splits(info, first)), "train")
    lines += [
        "",
        "World: metres, Z up, the head looks along -Y. Cameras: `camera_to_world` with OpenGL "
        "axes, `intrinsics` in pixels, pixel centres at +0.5. Undefined pixels are 0.",
        "",
        "## Reading it",
        "",
        "```python",
        "from synthgen.dataset import open_dataset",
        "",
        f'for shot in open_dataset("PATH", subset="{first}", split="{split}"):',
        "    print(shot.key, shot.rgb.shape, shot.depth.max())",
        "```",
        "",
        "```python",
        "import datasets",
        "",
        f'shots = datasets.load_dataset("PATH", "{first}", split="{split}")',
        "```",
        "",
        "## Licences of what it is made of",
        "",
        "| asset | for | licence |",
        "|---|---|---|",
    ]
    lines += [
        f"| [{entry['name']}]({entry['source']}) | {entry['used_for']} | {entry['licence']} |"
        for entry in info.licences
    ]
    lines += [
        f"| {entry['id']} ({entry['author'] or entry['source']}) | panorama | {entry['licence']} |"
        for entry in info.environments[:100]
    ]
    return "\n".join(lines) + "\n"


def _selected(info: Description) -> list[str]:
    """What a selection of another dataset has of it; nothing of a whole one."""
    lines = []
    for each in info.selections:
        asked = {"subset": each.subset, "split": each.split, "where": each.where}
        asked["tags"] = ", ".join(each.tags)
        said = "; ".join(
            f"{name} `{brief(value.replace('`', ' '))}`" for name, value in asked.items() if value
        )
        lines += [
            f"A selection of the dataset whose dataset.json has the sha256 `{each.source}`: "
            f"{said or 'all of it'}.",
            "",
        ]
    return lines


def _fields(info: Description) -> dict[str, str]:
    linear = info.job["image"]["linear"]
    return {name: text for name, text in FIELDS.items() if linear or not name.startswith("hdr")}
