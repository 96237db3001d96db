"""The tutorial runs, with pictures, over the small dataset."""

from __future__ import annotations

import copy
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

TUTORIAL = Path(__file__).parents[2] / "examples" / "tutorial.ipynb"


@pytest.fixture(scope="module")
def tutorial() -> nbformat.NotebookNode:
    return nbformat.read(TUTORIAL, as_version=4)


def test_it_runs_and_its_pictures_follow_the_light(
    tutorial: nbformat.NotebookNode, small_dataset: Path, tmp_path: Path
):
    notebook = copy.deepcopy(tutorial)
    (place,) = (cell for cell in notebook.cells if cell.source.startswith("folder = "))
    place.source = f"folder = {str(small_dataset)!r}"
    notebook.cells.append(
        nbformat.v4.new_code_cell(
            f"np.save({str(tmp_path / 'pair.npy')!r}, "
            "np.stack([relit(maps), relit(other)])[:, inside])"
        )
    )
    NotebookClient(notebook, timeout=120).execute()
    shaded, turned = np.load(tmp_path / "pair.npy")
    assert np.isfinite(shaded).all()
    assert np.abs(shaded - turned).mean() > 0.01
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in pictures) == 3


def test_it_is_kept_without_what_it_printed(tutorial: nbformat.NotebookNode):
    for cell in tutorial.cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
