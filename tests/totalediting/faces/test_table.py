import numpy as np
import pytest
from synthetic_faces import a_tracking

from totalediting.errors import InputError
from totalediting.faces import table
from totalediting.faces.table import FitTable


def a_table(count: int) -> FitTable:
    rng = np.random.default_rng(0)
    return FitTable(
        source=[f"a'b/[{k}].png" for k in range(count)],
        frame=np.arange(count),
        faces=np.ones(count, int),
        seconds=np.arange(count) / 25,
        confidence=rng.random(count),
        residual=rng.random(count),
        square=rng.random((count, 3)),
        tracking=a_tracking(rng, count),
        blendshapes=rng.random((count, 52)),
    )


@pytest.mark.parametrize("count", [0, 3])
def test_what_is_written_is_read(tmp_path, count):
    path, written = tmp_path / "it's [1].parquet", a_table(count)
    table.write(path, written)
    found = table.read(path)
    assert found.source == written.source
    assert found.rows() == {key: number for number, key in enumerate(written.rows())}
    for ours, theirs in zip(found.tracking, written.tracking, strict=True):
        assert (ours == theirs).all()
    assert np.allclose(found.square, written.square)
    assert np.allclose(found.seconds, written.seconds)
    assert np.allclose(found.blendshapes, written.blendshapes)


def test_another_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / "fits.parquet"
    path.write_bytes(b"no table")
    with pytest.raises(InputError, match=r"fits\.parquet") as error:
        table.read(path)
    assert "\n" not in str(error.value)


def test_a_value_that_is_not_finite_is_refused(tmp_path):
    path, written = tmp_path / "fits.parquet", a_table(2)
    written.square[1, 1] = np.nan
    table.write(path, written)
    with pytest.raises(InputError, match="square"):
        table.read(path)
